"""One robot, for the rest of the server: names and JSON values outside, bytes inside.

`Robot.listen`, `Robot.graph` and `Robot.ask_service` read. Everything that changes something is a command, and
`Robot.do` is the only way to carry one out.
"""

from ros2_mcp.model.commands import Answer, Sent
from ros2_mcp.model.graph import TopicEndpoints
from ros2_mcp.robot.listening import Listening
from ros2_mcp.robot.robot import Robot
from ros2_mcp_common.policy.velocity import HOLD_TYPES, MOTION_TYPES, VELOCITY_TYPES

__all__ = ["HOLD_TYPES", "MOTION_TYPES", "VELOCITY_TYPES", "Answer", "Listening", "Robot", "Sent", "TopicEndpoints"]
