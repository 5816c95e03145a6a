"""Tools, arguments and result fields that users of existing servers rely on, against the running server."""

from __future__ import annotations

from typing import Any

import pytest

STRING = "std_msgs/msg/String"
FIBONACCI = "test_msgs/action/Fibonacci"
GOAL = {"action_name": "/fibonacci", "action_type": FIBONACCI, "goal_fields": {"order": 1}}

ARGUMENTS: dict[str, dict[str, Any]] = {
    "ros2_topic_list": {},
    "ros2_topic_subscribe": {"topic_name": ..., "msg_type": "", "duration": None, "message_limit": None},
    "ros2_topic_echo_wait": {"topic_name": ..., "message_type": "", "timeout": 5.0},
    "ros2_subscribe_multiple_topics": {"topics": ...},
    "ros2_topic_publish": {
        "topic_name": ...,
        "message_type": "",
        "data": ...,
        "frequency": None,
        "duration": None,
    },
    "ros2_publish_multiple_topics": {"topics": ...},
    "ros2_get_message_fields": {"message_type": ...},
    "ros2_interface_list": {"pattern": "", "kind": "", "package": ""},
    "ros2_service_list": {"pattern": "", "include_hidden": False},
    "ros2_service_call": {"service_name": ..., "service_type": "", "fields": None, "force_call": False},
    "ros2_list_actions": {},
    "ros2_send_action_goal": {
        "action_name": ...,
        "action_type": "",
        "goal_fields": ...,
        "wait_for_result": False,
        "timeout_sec": 60.0,
    },
    "ros2_cancel_action_goal": {
        "action_name": ...,
        "goal_id_hex": "",
        "cancel_all": False,
        "stamp_sec": 0,
        "stamp_nanosec": 0,
        "wait_timeout_sec": 3.0,
    },
    "ros2_action_request_result": {
        "action_name": ...,
        "action_type": "",
        "goal_id_hex": ...,
        "timeout_sec": 60.0,
        "wait_for_service_sec": 3.0,
    },
    "ros2_action_subscribe_feedback": {
        "action_name": ...,
        "action_type": "",
        "goal_id_hex": None,
        "duration_sec": 5.0,
        "max_messages": 100,
    },
    "ros2_action_subscribe_status": {"action_name": ..., "duration_sec": 5.0, "max_messages": 100},
}
"""Tool → argument → its default; `...` is required. The type is never required, because the graph knows it, nor are the
fields of a service's request, because it may have none.
"""

CALLS: list[tuple[str, dict[str, Any], str]] = [
    ("ros2_topic_list", {}, "topics[].topic_name topics[].topic_type"),
    ("ros2_topic_subscribe", {"topic_name": "/contract"}, "messages[].data count duration"),
    ("ros2_topic_subscribe", {"topic_name": "/contract", "duration": 0.1}, "messages count duration"),
    (
        "ros2_topic_subscribe",
        {"topic_name": "/contract", "duration": 20, "message_limit": 1},
        "messages[].data count duration",
    ),
    ("ros2_topic_subscribe", {"topic_name": "/contract", "message_limit": 1}, "messages[].data count duration"),
    ("ros2_topic_echo_wait", {"topic_name": "/contract", "timeout": 20}, "message.data received"),
    (
        "ros2_subscribe_multiple_topics",
        {"topics": [{"name": "/contract", "message_limit": 1}, {"name": "/contract", "duration": 0.1}]},
        "topics[].messages[].data topics[].count topics[].duration",
    ),
    (
        "ros2_topic_publish",
        {"topic_name": "/contract_said", "message_type": STRING, "data": {"data": "x"}},
        "status sent subscribers",
    ),
    (
        "ros2_topic_publish",
        {"topic_name": "/contract_said", "data": {}, "message_type": STRING, "frequency": 20, "duration": 0.1},
        "status sent subscribers",
    ),
    (
        "ros2_publish_multiple_topics",
        {"topics": [{"topic_name": "/contract_said", "message_type": STRING, "data": {}, "duration": 0.1}]},
        "topics[].status topics[].sent topics[].subscribers",
    ),
    ("ros2_interface_list", {"pattern": "std_srvs/*"}, "interfaces[]"),
    ("ros2_service_list", {}, "services[].service_name services[].service_type services[].request_fields"),
    (
        "ros2_service_call",
        {"service_name": "/set_lamp", "service_type": "std_srvs/srv/SetBool", "fields": {"data": True}},
        "result.success result.message",
    ),
    ("ros2_list_actions", {}, "actions[].name actions[].types[] actions[].request_fields"),
    (
        "ros2_send_action_goal",
        {**GOAL, "wait_for_result": True},
        "accepted goal_id send_goal_stamp waited result_timeout_sec status_code status result.sequence",
    ),
    (
        "ros2_cancel_action_goal",
        {"action_name": "/fibonacci", "cancel_all": True, "wait_timeout_sec": 20},
        "service return_code return_code_text goals_canceling",
    ),
    (
        "ros2_action_subscribe_status",
        {"action_name": "/fibonacci", "duration_sec": 20, "max_messages": 1},
        "topic duration_sec frames[].stamp frames[].statuses[].goal_id frames[].statuses[].accept_stamp "
        "frames[].statuses[].status_code frames[].statuses[].status",
    ),
]


@pytest.fixture(scope="module", autouse=True)
def graph(agent, peer, small_robot) -> None:
    peer.offer(topic="/contract", kind=STRING, seed=1, latched=True)
    peer.listen(topic="/contract_said", kind=STRING)
    agent.knows("/contract", "/contract_said")


@pytest.mark.parametrize("name", ARGUMENTS)
def test_a_tool_takes_these_arguments_with_these_defaults(agent, name: str) -> None:
    schema = agent.tools()[name].input_schema
    properties, required = schema["properties"], schema.get("required", [])
    for argument, default in ARGUMENTS[name].items():
        assert argument in properties
        assert (argument in required) == (default is ...)
        if default is not ...:
            # An empty text is what is not given: as with null, that is not told of what need not be there.
            assert properties[argument].get("default") == (None if default == "" else default)


@pytest.mark.promise("ros2_topic_subscribe", "QoS is chosen to match the publishers")
@pytest.mark.promise("ros2_action_subscribe_status", "the last known states come first")
@pytest.mark.promise("ros2_topic_publish", "Publish a message once, or repeatedly with frequency and duration")
@pytest.mark.parametrize(("tool", "arguments", "fields"), CALLS, ids=[f"{c[0]}-{i}" for i, c in enumerate(CALLS)])
def test_a_result_has_these_fields(agent, tool: str, arguments: dict[str, Any], fields: str) -> None:
    assert_has(agent.call(tool, **arguments), fields)


def assert_has(result: dict[str, Any], fields: str) -> None:
    for path in fields.split():
        value_at(result, path)


def value_at(value: Any, path: str) -> Any:
    """The value at a path such as `topics[].count`; the first element stands for all, and must be there."""
    for part in path.split("."):
        value = value[part.removesuffix("[]")]
        value = value[0] if part.endswith("[]") else value
    return value


@pytest.mark.promise("ros2_send_action_goal", "call ros2_action_request_result with the goal_id later")
def test_feedback_and_result_of_a_goal_that_was_not_waited_for(agent) -> None:
    feedback = agent.begin("ros2_action_subscribe_feedback", **without_goal(), duration_sec=40, max_messages=3)
    while not agent.call("ros2_topic_info", topic_name="/fibonacci/_action/feedback")["subscribers"]:
        assert not feedback.done()
    # It lasts 5 s: a robot that has not discovered the reader of the feedback at first does so within 3 s.
    goal = agent.call("ros2_send_action_goal", **{**GOAL, "goal_fields": {"order": 50}})
    assert (goal["accepted"], len(goal["goal_id"]), goal["waited"]) == (True, 32, False)
    heard = feedback.result(50)
    assert_has(
        heard, "topic action_type goal_id_filter duration_sec messages[].feedback.sequence messages[].recv_stamp"
    )
    assert {message["goal_id"] for message in heard["messages"]} == {goal["goal_id"]}
    result = agent.call("ros2_action_request_result", **without_goal(), goal_id_hex=goal["goal_id"])
    assert_has(result, "service goal_id waited result_timeout_sec status_code status result.sequence")
    assert (result["status_code"], result["status"]) == (4, "SUCCEEDED")


def without_goal() -> dict[str, Any]:
    return {name: GOAL[name] for name in ("action_name", "action_type")}


@pytest.mark.promise("ros2_get_message_fields", "with an example value ready to fill in")
def test_both_spellings_of_the_type_are_accepted(agent) -> None:
    for spelling in ("msg_type", "message_type"):
        for kind in ("std_msgs/msg/String", "std_msgs/String"):
            assert agent.call("ros2_topic_subscribe", topic_name="/contract", **{spelling: kind})["count"] == 1
            assert agent.call("ros2_topic_echo_wait", topic_name="/contract", **{spelling: kind})["received"]
            sent = agent.call("ros2_topic_publish", topic_name="/contract_said", data={}, **{spelling: kind})
            assert sent["status"] == "published"
            assert agent.call("ros2_get_message_fields", **{spelling: kind})["examples"] == {"message": {"data": ""}}
            several = [{"topic_name": "/contract_said", spelling: kind, "data": {}, "duration": 0.1}]
            assert agent.call("ros2_publish_multiple_topics", topics=several)["topics"][0]["status"] == "published"
            several = [{"name": "/contract", spelling: kind}]
            assert agent.call("ros2_subscribe_multiple_topics", topics=several)["topics"][0]["count"] == 1


@pytest.mark.promise(
    "ros2_service_call", "If request fields are missing, the service is not called, and the result names them"
)
def test_missing_request_fields_are_named_and_can_be_forced(agent) -> None:
    answer = agent.call("ros2_service_call", service_name="/set_lamp", fields={})
    assert (answer["called"], answer["missing_fields"]) == (False, ["data"])
    assert "force_call" in answer["note"]
    forced = agent.call("ros2_service_call", service_name="/set_lamp", fields={}, force_call=True)
    assert forced["result"] == {"success": False, "message": "lamp off"}


@pytest.mark.promise("README", "--read-only (or ROS2_MCP_READONLY=1): tools that write are absent, not refused")
def test_a_read_only_server_has_no_tool_that_writes(start_agent, agent) -> None:
    tools = start_agent("--tools", "all", ROS2_MCP_READONLY="1").tools()
    assert {"ros2_topic_list", "ros2_topic_subscribe", "ros2_action_request_result"} <= set(tools)
    assert not any(verb in name for name in tools for verb in ("publish", "service_call", "send", "cancel", "_set"))
    assert all(tool.annotations.read_only_hint for tool in tools.values())
    writing = {name for name, tool in agent.tools().items() if not tool.annotations.read_only_hint}
    assert set(agent.tools()) - set(tools) == writing - {"ros2_program_run"}  # there it runs programs that only read
