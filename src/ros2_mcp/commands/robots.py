"""The simulated robots that `ros2-mcp demo` can start, and what each wants. Cheap to import: no libraries."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

ROBOTS: Mapping[str, Sequence[str]] = {
    "rover": ("tf2_msgs", "ros2_mcp_demo_interfaces"),
    "arm": ("tf2_msgs",),
    "drone": ("tf2_msgs", "geographic_msgs"),
    "nav2": ("tf2_msgs", "ros2_mcp_demo_interfaces"),
}
"""Each robot's name, and the packages below `ros2_mcp_demo/interfaces` that are built before it starts.

`ros2_mcp_demo.robots` has the same names. A robot runs without what cannot be built, and says what it leaves out.
"""
LATER: Mapping[str, Sequence[str]] = {
    "rover": ("nav2_msgs", "map_msgs"),  # the latter for what changes in costmaps of other robots
    "arm": ("control_msgs",),
    "drone": ("geographic_msgs", "mavros_msgs"),
    "nav2": ("nav2_msgs", "map_msgs"),
}
"""Those that are built while the robot runs already: its nodes that need them join then, so that nobody waits.

What one of them needs of another is built before, too.
"""
DEFAULT = "rover"
