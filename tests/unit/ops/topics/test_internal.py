"""Which topics nodes keep for themselves: lists of large stacks count them in one line."""

from __future__ import annotations

import pytest

from ros2_mcp.ops.topics.list import is_internal


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("/bond", "bond/msg/Status"),
        ("/amcl/transition_event", "lifecycle_msgs/msg/TransitionEvent"),
        ("/global_costmap/costmap_raw", "nav2_msgs/msg/Costmap"),
        ("/global_costmap/costmap_updates", "map_msgs/msg/OccupancyGridUpdate"),
        ("/local_costmap/clearing_endpoints", "sensor_msgs/msg/PointCloud2"),
    ],
)
def test_what_nodes_keep_for_themselves_is_internal(name: str, kind: str) -> None:
    assert is_internal(name, [kind])


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("/scan", "sensor_msgs/msg/LaserScan"),
        ("/global_costmap/costmap", "nav_msgs/msg/OccupancyGrid"),
        ("/plan", "nav_msgs/msg/Path"),
        ("/points", "sensor_msgs/msg/PointCloud2"),
    ],
)
def test_what_others_use_is_not(name: str, kind: str) -> None:
    assert not is_internal(name, [kind])
