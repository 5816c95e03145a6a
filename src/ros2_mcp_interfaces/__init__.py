"""Builds ROS 2 interface packages (.msg, .srv, .action) without colcon, for ROS 2 installed from wheels.

Runs under the ROS installation's Python, with the standard library and that installation's `rosidl` modules only.
"""

from ros2_mcp_interfaces.builder import build, finished, planned
from ros2_mcp_interfaces.cache import default_cache
from ros2_mcp_interfaces.errors import BuildError

__all__ = ["BuildError", "build", "default_cache", "finished", "planned"]
