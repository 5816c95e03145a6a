"""What clients send that is not of the schema's type: tools that act refuse it, and nothing reaches the robot."""

from __future__ import annotations

from typing import Any

import pytest

from ros2_mcp.compose.server import assemble
from ros2_mcp.mcp.binding import BoundTool, CallFailed
from ros2_mcp.model.text import quoted
from ros2_mcp.ops.results.results import silent
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
    assert said.startswith("BadInput: frequency: a string is given, a number is expected.")
    several = [{**TWIST, "data": GO}, {**TWIST, "data": GO, "duration": text}]
    assert "topics[1].duration: a string" in await refusal("ros2_publish_multiple_topics", topics=several)
    relay = {"source_topic": "/a", "destination_topic": "/b", "tolerances": {"x": text}}
    assert "tolerances.x: a string" in await refusal("ros2_relay_start", **relay)


async def test_an_id_that_is_none_is_refused_beside_cancel_all() -> None:
    said = await refusal("ros2_cancel_action_goal", action_name="/go", goal_id_hex="the last one", cancel_all=True)
    assert said.startswith("BadValue: goal_id_hex: 'the last one' is not a goal id.")


async def test_two_spellings_of_one_argument_are_refused_with_both() -> None:
    twice = {"topic_name": "/a", "message_type": "std_msgs/msg/String", "msg_type": "std_msgs/msg/Int32"}
    said = await refusal("ros2_topic_publish", **twice, data={"data": 1})
    assert said.startswith("BadInput: 'message_type' and 'msg_type' are two names of one argument")


@pytest.mark.parametrize(
    ("name", "wrong", "right"),
    [
        ("ros2_topic_publish", "message", "data"),
        ("ros2_topic_publish", "rate", "frequency"),
        ("ros2_topic_subscribe", "count", "message_limit"),
        ("ros2_service_call", "request", "fields"),
        ("ros2_service_call", "type", "service_type"),
        ("ros2_send_action_goal", "goal", "goal_fields"),
        ("ros2_parameter_set", "parameters", "values"),
        ("ros2_wait_until", "expression", "condition"),
    ],
)
async def test_an_argument_of_another_name_is_refused_with_the_one_that_is_meant(
    name: str, wrong: str, right: str
) -> None:
    assert f"{name} has no argument '{wrong}'. Did you mean {right}?" in await refusal(name, **{wrong: "x"})


@pytest.mark.parametrize(
    ("name", "given", "taken"),
    [
        ("ros2_topic_publish", {"topic_type": "a/msg/B"}, {"message_type": "a/msg/B"}),
        ("ros2_topic_publish", {"duration_sec": 2.0}, {"duration": 2.0}),
        ("ros2_joint_move", {"duration": 2.0}, {"duration_s": 2.0}),
        ("ros2_topic_subscribe", {"topic": "/a", "timeout_s": 3}, {"topic_name": "/a", "duration": 3}),
        ("ros2_topic_echo_wait", {"duration": 3}, {"timeout": 3}),
        ("ros2_topic_stats", {"topic_name": "/a"}, {"topic_names": ["/a"]}),
        ("ros2_topic_stats", {"topic_names": "/a"}, {"topic_names": ["/a"]}),
        ("ros2_node_info", {"node_names": ["/n"]}, {"node_name": "/n"}),
        ("ros2_parameter_list", {"node_name": "/n"}, {"node_names": ["/n"]}),
        ("ros2_parameter_get", {"node": "/n", "names": "rate"}, {"node_name": "/n", "names": ["rate"]}),
        ("ros2_service_call", {"service": "/s", "timeout": 2}, {"service_name": "/s", "timeout_sec": 2}),
        ("ros2_cancel_action_goal", {"timeout_sec": 2}, {"wait_timeout_sec": 2}),
        ("ros2_record_stop", {"recording": "run"}, {"recording_id": "run"}),
        ("ros2_record_status", {"bag": "run"}, {"recording_id": "run"}),
        ("ros2_bag_info", {"recording_id": "run"}, {"bag": "run"}),
        ("ros2_publish_multiple_topics", {"topics": {"topic_name": "/a"}}, {"topics": [{"topic_name": "/a"}]}),
    ],
)
def test_names_and_forms_that_mean_the_same_are_taken_and_told(
    name: str, given: dict[str, Any], taken: dict[str, Any]
) -> None:
    meant, told = tool(name)._as_meant(given)  # pyright: ignore[reportPrivateUsage] - nothing is called here
    assert meant == taken
    assert len(told) == sum(own not in given for own in taken) + sum(
        type(value) is not type(other) for value, other in zip(given.values(), taken.values(), strict=True)
    )


@pytest.mark.parametrize(
    ("name", "given"),
    [
        ("ros2_move_until", {"duration": 3}),  # how long it moves is not how long it is waited for
        ("ros2_drive", {"timeout": 3}),
        ("ros2_node_info", {"node_names": ["/a", "/b"]}),
        ("ros2_topic_stats", {"topic_names": 7}),
        ("ros2_record_start", {"topic_names": ""}),
    ],
)
async def test_what_could_mean_something_else_is_refused(name: str, given: dict[str, Any]) -> None:
    assert await refusal(name, **given)


@pytest.mark.parametrize("more", [{"reason": "emergency"}, {"confirm": None}, {"a\ud800": 1}])
async def test_what_stops_ignores_arguments_that_it_does_not_have_and_tells(more: dict[str, Any]) -> None:
    checked, told = tool("ros2_stop")._checked(more)  # pyright: ignore[reportPrivateUsage] - nothing is stopped here
    assert not checked.model_dump()
    assert told == [f"ros2_stop has no argument {quoted(next(iter(more)))}: ignored."]


async def test_a_name_that_is_no_text_is_told_as_one() -> None:
    assert (await refusal("ros2_topic_list", **{"a\ud800": 1})).startswith("BadInput: the name of an argument: ")


@pytest.mark.parametrize("to", [[1, 0], [[1, 0]], 5])
async def test_coordinates_alone_are_no_place_and_the_error_shows_one(to: Any) -> None:
    said = await refusal("ros2_navigate", to=to)
    assert said.startswith("BadInput: to: ") and 'is not a place: write {"x": 1, "y": 0} or its name.' in said


async def test_what_a_program_gives_is_taken_as_it_is_and_what_a_model_was_shown_as_it_was_meant() -> None:
    shown = {"node_name": "/n", "values": {"name": "⟦U+200D⟧"}}
    bound = tool("ros2_parameter_set")
    for are_exact, value in ((False, "\u200d"), (True, "⟦U+200D⟧")):
        checked, _ = bound._checked(shown, are_exact=are_exact)  # pyright: ignore[reportPrivateUsage] - nothing is set
        assert checked.model_dump()["values"] == {"name": value}
