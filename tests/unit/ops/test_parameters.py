"""Parameters of nodes that cannot be told apart."""

from __future__ import annotations

from typing import Any

from ros2_mcp.ops.nodes.parameters import Dump, SetResult, shared_names
from support.made_bridge import MadeBridge, robot_of


class TwoRobots(MadeBridge):
    async def _nodes(self, **_: Any) -> Any:
        return {"settled": True, "nodes": [("nav", "/"), ("nav", "/"), ("map", "/"), ("map", "/"), ("lidar", "/")]}


async def test_of_a_node_whose_name_another_has_it_is_told_that_nobody_knows_which_answers() -> None:
    robot = robot_of(TwoRobots())
    note = await shared_names(robot, ["/nav", "/lidar"])
    assert note == "2 nodes have the name /nav; it is unknown which one answered."
    assert await shared_names(robot, ["/lidar"]) == ""
    both = await shared_names(robot, ["/nav", "/map"])
    assert both == "Several nodes each have the name /nav, /map; it is unknown which one answered."
    assert note in Dump("/nav", {}, [], {}, note).summary()
    assert note in SetResult("/nav", True, False, [], note).summary()[0]
