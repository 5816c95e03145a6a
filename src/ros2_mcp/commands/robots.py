"""The simulated robots of `ros2-mcp demo`, and the packages that each needs. Quick to import: no libraries."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

ROBOTS: Mapping[str, Sequence[str]] = {
    "rover": ("tf2_msgs", "ros2_mcp_demo_interfaces"),
    "arm": ("tf2_msgs",),
    "drone": ("tf2_msgs", "geographic_msgs"),
    "nav2": ("tf2_msgs", "ros2_mcp_demo_interfaces"),
}
"""For each robot, the packages below `ros2_mcp_demo/interfaces` that are built before it starts.

`ros2_mcp_demo.robots` has the same names. A robot runs without packages that cannot be built, and reports what is
missing.
"""
LATER: Mapping[str, Sequence[str]] = {
    "rover": ("nav2_msgs", "map_msgs"),  # the latter for updates of other robots' costmaps
    "arm": ("control_msgs",),
    "drone": ("geographic_msgs", "mavros_msgs"),
    "nav2": ("nav2_msgs", "map_msgs"),
}
"""For each robot, the packages that are built while it runs: nodes that need them start later, so that the user does
not wait.

A robot's packages include those that its other packages need; these are built first.
"""
DEFAULT = "rover"
