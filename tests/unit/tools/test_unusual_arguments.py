"""Numbers that are not finite, names that are empty, and null where a value is required: no tool takes them."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from typing import Any

import pytest

from ros2_mcp.compose.server import assemble
from ros2_mcp.mcp.binding import BoundTool, CallFailed
from ros2_mcp.ops.results.results import silent
from ros2_mcp.settings import Settings

TOOLS = list(assemble(Settings(tools=("all",))).toolset.by_name.values())
REFUSING = [tool for tool in TOOLS if tool.declaration.risk != "stop"]
WORDS = {"string": "a text", "array": "a list", "object": "an object"}
HUGE = 10**400
"""An integer that no floating-point number can hold."""

each_tool = pytest.mark.parametrize("tool", REFUSING, ids=[tool.name for tool in REFUSING])


def arguments_of(tool: BoundTool, *types: str) -> Iterator[tuple[str, Mapping[str, Any]]]:
    properties = tool.listed.input_schema["properties"]
    return ((name, node) for name, node in properties.items() if node.get("type") in types)


async def refusal(tool: BoundTool, **arguments: Any) -> str:
    with pytest.raises(CallFailed) as refused:
        await tool.call(arguments, silent)
    return str(refused.value)


@each_tool
async def test_a_number_that_is_not_finite_is_refused_with_what_is_expected(tool: BoundTool) -> None:
    for name, node in arguments_of(tool, "number", "integer"):
        kind = "a whole number" if node["type"] == "integer" else "a finite number"
        for number in (math.inf, -math.inf, math.nan):
            said = await refusal(tool, **{name: number})
            assert f"BadInput: {name}: {kind}" in said and f"is expected, not {json.dumps(number)}." in said
            assert f" at most {node['maximum']:g}" in said if "maximum" in node else " at most " not in said


@each_tool
async def test_a_number_or_a_text_that_stands_for_such_a_number_is_refused_too(tool: BoundTool) -> None:
    for name, node in arguments_of(tool, "number", "integer"):
        texts = ("Infinity", "-Infinity", "NaN", "1e400", "inf", "nan")
        for given in texts if node["type"] == "integer" else (*texts, HUGE, -HUGE):
            assert f"BadInput: {name}: " in await refusal(tool, **{name: given})


async def test_the_refusal_names_the_bounds() -> None:
    stats = next(tool for tool in TOOLS if tool.name == "ros2_topic_stats")
    for given, shown in ((math.inf, "Infinity"), ("1e400", '"1e400"')):
        expected = f"BadInput: duration_s: a finite number above 0 and at most 600 is expected, not {shown}."
        assert await refusal(stats, duration_s=given) == expected
    nodes = next(tool for tool in TOOLS if tool.name == "ros2_node_list")
    expected = "BadInput: limit: a whole number of at least 1 and at most 2000 is expected, not Infinity."
    assert await refusal(nodes, limit=math.inf) == expected


async def test_a_number_that_is_not_finite_is_refused_within_a_list() -> None:
    several = next(tool for tool in TOOLS if tool.name == "ros2_subscribe_multiple_topics")
    said = await refusal(several, topics=[{"name": "/odom"}, {"name": "/imu", "duration": math.inf}])
    expected = "BadInput: topics.1.duration: a finite number above 0 and at most 3600 is expected, not Infinity."
    assert said == expected


@each_tool
async def test_an_argument_whose_name_is_empty_is_refused(tool: BoundTool) -> None:
    for name in ("", " ", "\u200b"):
        assert f"{tool.name} has no argument " in await refusal(tool, **{name: 5})


async def test_what_stops_ignores_an_argument_whose_name_is_empty_and_tells() -> None:
    stop = next(tool for tool in TOOLS if tool.name == "ros2_stop")
    _, told = stop._checked({"": 5})  # pyright: ignore[reportPrivateUsage] - nothing is stopped here
    assert told == ["ros2_stop has no argument «»: ignored."]


@each_tool
async def test_null_for_a_required_argument_is_refused_with_what_is_expected(tool: BoundTool) -> None:
    schema = tool.listed.input_schema
    for name in schema.get("required", ()):
        kind = WORDS[schema["properties"][name]["type"]]
        said = await refusal(tool, **{name: None})
        assert f"BadInput: {name}: {kind}" in said and "is expected, not null." in said
