"""Parameters of nodes that cannot be told apart, and of nodes that leave some without a value."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest

from ros2_mcp.ops.nodes.own_services import set_values
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


REAL_MONITOR = {"polygons": 9, "FootprintApproach.points": 0, "FootprintApproach.max_points": 0, "scan.topic": 4}
"""Types of parameters as a real collision monitor declares them; of 0 are those without a value."""


class RclcppNode:
    """Answers as a node of rclcpp does: with nothing, if one of the parameters has no value."""

    def __init__(self, *, knows_types: bool = True) -> None:
        self.requests, self._knows_types = 0, knows_types

    async def get(self, wanted: Sequence[str]) -> Sequence[Any]:
        self.requests += 1
        values = {9: {"type": 9, "string_array_value": ["Stop"]}, 4: {"type": 4, "string_value": "/scan"}}
        kinds = [REAL_MONITOR[name] for name in wanted]
        return [values[kind] for kind in kinds] if all(kinds) else []

    async def types(self, wanted: Sequence[str]) -> Sequence[int]:
        self.requests += 1
        return [REAL_MONITOR[name] for name in wanted] if self._knows_types else []


@pytest.mark.parametrize(("knows_types", "requests"), [(True, 3), (False, 9)])
async def test_a_parameter_without_a_value_takes_no_other_values_away(knows_types: bool, requests: int) -> None:
    node = RclcppNode(knows_types=knows_types)
    values = await set_values(node.get, node.types, list(REAL_MONITOR))
    assert values == {"polygons": ["Stop"], "scan.topic": "/scan"}
    assert node.requests <= requests
