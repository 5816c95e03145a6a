"""The only door to the robot: resolve the name, ask the guard, check the values, encode, send.

Everything above speaks names and JSON values; everything below speaks bytes.
"""

from ros2_mcp.model.graph import TopicEndpoints
from ros2_mcp.robot.door import VELOCITY_TYPES, Robot
from ros2_mcp.robot.exchange import Answer, Listening, Sent

__all__ = ["VELOCITY_TYPES", "Answer", "Listening", "Robot", "Sent", "TopicEndpoints"]
