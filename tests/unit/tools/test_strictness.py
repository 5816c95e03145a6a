"""What clients send that is not of the schema's type: tools that act refuse it, and nothing reaches the robot."""

from __future__ import annotations

from typing import Any

import pytest

from ros2_mcp.assembly import assemble
from ros2_mcp.binding import BoundTool, CallFailed
from ros2_mcp.ops.results import silent
from ros2_mcp.settings import Settings

TWIST = {"topic_name": "/cmd_vel", "message_type": "geometry_msgs/msg/Twist"}
GO = {"linear": {"x": 0.1}}


def tool(name: str) -> BoundTool:
    return assemble(Settings(tools=("all",))).toolset.by_name[name]


async def refusal(name: str, **arguments: Any) -> str:
    with pytest.raises(CallFailed) as refused:
        await tool(name).call(arguments, silent)
    return str(refused.value)


@pytest.mark.parametrize("nothing", ["{}", " {} ", "[]", "", "null", None, [], "0", "false"])
async def test_what_is_no_object_is_never_published_as_a_message_of_defaults(nothing: Any) -> None:
    assert "data: an object is expected" in await refusal("ros2_topic_publish", **TWIST, data=nothing)
    several = [{**TWIST, "data": nothing}]
    assert "topics.0.data: an object" in await refusal("ros2_publish_multiple_topics", topics=several)
    assert "goal_fields: an object" in await refusal("ros2_send_action_goal", action_name="/go", goal_fields=nothing)


@pytest.mark.parametrize("text", ["1 ", "1", "nan", "", "null", "true"])
async def test_a_text_is_no_number_where_the_tool_acts(text: str) -> None:
    said = await refusal("ros2_topic_publish", **TWIST, data=GO, frequency=text, duration=1)
    assert said.startswith("BadInput: frequency: a text is given, a number is expected.")
    several = [{**TWIST, "data": GO}, {**TWIST, "data": GO, "duration": text}]
    assert "topics[1].duration: a text" in await refusal("ros2_publish_multiple_topics", topics=several)
    relay = {"source_topic": "/a", "destination_topic": "/b", "tolerances": {"x": text}}
    assert "tolerances.x: a text" in await refusal("ros2_relay_start", **relay)


async def test_an_id_that_is_none_is_refused_beside_cancel_all() -> None:
    said = await refusal("ros2_cancel_action_goal", action_name="/go", goal_id_hex="the last one", cancel_all=True)
    assert said.startswith("BadValue: goal_id_hex: 'the last one' is not a goal id.")
