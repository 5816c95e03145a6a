"""Arguments of any wrong kind: what is expected is said in words of ours, and what is clear is understood."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from pydantic import ValidationError
from pydantic_core._pydantic_core import list_all_errors

from ros2_mcp.compose.server import assemble
from ros2_mcp.mcp.binding import BoundTool, explained
from ros2_mcp.settings import Settings
from ros2_mcp.tools.leniency import as_meant

TOOLS = assemble(Settings(tools=("all",))).toolset.by_name
ODD: tuple[Any, ...] = (True, -7, 1e9, 0.5, "no such", "", [], [[]], [5], ["a", 5], {}, {"odd": 1}, {"name": 5}, [None])
OURS = ("value_error", "assertion_error", "missing", "extra_forbidden")
THEIRS = [
    start
    for error in list_all_errors()
    if error["type"] not in OURS and len(start := error["message_template_python"].partition("{")[0]) > 12
]
"""How the sentences of the library begin."""


def calls(tool: BoundTool) -> Iterator[dict[str, Any]]:
    """Each argument with each odd value, and each field of an element of a list."""
    for name, node in tool.listed.input_schema["properties"].items():
        yield from ({name: odd} for odd in ODD)
        for below in node.get("items", {}).get("properties", {}):
            yield from ({name: [{below: odd}]} for odd in ODD)


@pytest.mark.parametrize("tool", TOOLS.values(), ids=TOOLS)
def test_no_sentence_of_a_library_is_said_of_an_odd_argument(tool: BoundTool) -> None:
    assert len(THEIRS) > 50
    for arguments in calls(tool):
        taken, _ = as_meant(tool.listed.input_schema, arguments, acts=tool.acts)
        try:
            tool.arguments.model_validate(taken)
        except ValidationError as error:
            said = explained(tool.name, error, tool.listed.input_schema)
            assert not any(start in said for start in THEIRS), (arguments, said)


@pytest.mark.parametrize("given", [["/odom", {"name": "/scan", "message_limit": 2}], "/odom", {"name": "/odom"}])
def test_a_text_is_the_object_that_needs_only_that_text(given: Any) -> None:
    tool = TOOLS["ros2_subscribe_multiple_topics"]
    taken, told = as_meant(tool.listed.input_schema, {"topics": given}, acts=False)
    assert taken["topics"][0] == {"name": "/odom"}
    assert tool.arguments.model_validate(taken).model_dump()["topics"][0]["name"] == "/odom"
    assert told


def test_a_text_for_an_object_that_needs_more_is_answered_with_its_form() -> None:
    tool = TOOLS["ros2_publish_multiple_topics"]
    taken, told = as_meant(tool.listed.input_schema, {"topics": ["/cmd_vel"]}, acts=True)
    assert (taken, told) == ({"topics": ["/cmd_vel"]}, [])
    with pytest.raises(ValidationError) as refused:
        tool.arguments.model_validate(taken)
    said = explained(tool.name, refused.value, tool.listed.input_schema)
    assert said == 'BadInput: topics.0: an object such as {"topic_name": …, "data": …} is expected, not "/cmd_vel".'
