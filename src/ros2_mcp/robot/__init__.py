"""The robot: names and JSON values above, bytes below.

Reading goes through `Robot.listen`, `Robot.graph` and `Robot.ask_service`; everything that acts is a command, and
`Robot.do` is the only way to carry it out.
"""

from ros2_mcp.model.commands import Answer, Sent
from ros2_mcp.model.graph import TopicEndpoints
from ros2_mcp.robot.listening import Listening
from ros2_mcp.robot.robot import Robot
from ros2_mcp_common.policy.velocity import HOLD_TYPES, MOTION_TYPES, VELOCITY_TYPES

__all__ = ["HOLD_TYPES", "MOTION_TYPES", "VELOCITY_TYPES", "Answer", "Listening", "Robot", "Sent", "TopicEndpoints"]
