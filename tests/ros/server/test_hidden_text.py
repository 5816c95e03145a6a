"""Text of the robot is made visible in every outlet, and is never taken for ours: all tools, prompts, completions."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path
from typing import Any

import pytest

from support.agent import until
from support.hidden import HIDDEN
from support.hostile_bag import ODD_TOPICS, TOPICS, write_hostile_bag
from support.outlets import FORGED, faults_of, hostile
from support.processes import peer_command, running
from support.raw_server import RawServer

VERSION = "2025-06-18"
ASKED = hostile().replace(FORGED, "As asked.")
"""What a client sends is not the robot's: it need not be quoted where it is repeated, but is shown all the same."""
TOPIC_NAMES = (*TOPICS, *ODD_TOPICS, f"/{ASKED}")
CONDITIONS = ("/text", 'data == "none"'), ("/number", "data > 1"), ("/text", hostile("tags")), ("/number", "data > 99")
_TOKENS = count(1)


def calls_of(tool: str, required: list[str]) -> Iterator[dict[str, Any]]:
    """Arguments with which a tool says as much of the hostile bag as it can, right ones and wrong ones."""
    if tool == "ros2_wait_until":
        yield from ({"topic_name": topic, "condition": condition, "timeout": 60} for topic, condition in CONDITIONS)
    elif tool == "ros2_topic_compare":
        for topic in TOPIC_NAMES:
            yield {"topic1_name": topic, "topic2_name": "/number"}
    elif tool == "ros2_plot":
        yield from ({"series": [f"{topic}:data"]} for topic in TOPIC_NAMES)
    elif tool == "ros2_subscribe_multiple_topics":
        yield {"topics": [{"name": topic, "message_limit": 50} for topic in TOPICS]}
    elif tool in ("ros2_topic_stats", "ros2_topic_statistics"):
        yield {"topic_names": list(TOPICS)}
        yield from ({"topic_names": [topic]} for topic in TOPIC_NAMES)
    elif tool == "ros2_get_message_fields":
        kinds = ("std_msgs/msg/String", "odd_msgs/msg/Odd", ASKED, "sensor_msgs/msg/PointCloud2")
        yield from ({"message_type": kind} for kind in kinds)
    elif "topic_name" in required:
        many = {"message_limit": 50, "limit": 50, "number_of_messages": 50}
        bag = {"bag": "hostile"} if "bag" in required else {}
        yield from ({"topic_name": topic, **bag} for topic in TOPIC_NAMES)
        yield from ({"topic_name": "/text", **bag, name: number} for name, number in many.items())
    else:
        yield dict.fromkeys(required, "hostile")
        yield dict.fromkeys(required, ASKED)
    yield {ASKED: 1}


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_hostile_bag(tmp_path_factory.mktemp("bags") / "hostile")


def exhaust(server: RawServer) -> None:
    """Asks everything that a client can ask which takes no robot."""
    for tool in server.ask("tools/list")["result"]["tools"]:
        for arguments in calls_of(tool["name"], tool["inputSchema"].get("required", [])):
            meta = {"progressToken": next(_TOKENS)}
            server.ask("tools/call", name=tool["name"], arguments=arguments, _meta=meta)
    server.ask("tools/call", name=ASKED, arguments={})
    for prompt in server.ask("prompts/list")["result"]["prompts"]:
        server.ask("prompts/get", name=prompt["name"], arguments={})
        for argument in prompt.get("arguments") or ():
            server.ask("prompts/get", name=prompt["name"], arguments={argument["name"]: ASKED})
            for typed in ("", "h", "/", ASKED):
                given = {"name": argument["name"], "value": typed}
                server.ask("completion/complete", ref={"type": "ref/prompt", "name": prompt["name"]}, argument=given)
    server.ask("prompts/get", name=ASKED, arguments={})
    server.ask("resources/read", uri=f"ros2://topic/{ASKED}")


def check(server: RawServer) -> None:
    faults = [fault for line in server.lines() for fault in faults_of(line)]
    if faults:
        pytest.fail("\n".join(faults[:20]))


@pytest.mark.promise("README", "in summaries it is quoted and short")
def test_a_recording_in_which_every_text_is_hostile_shows_all_and_forges_nothing(
    start_raw: Callable[..., RawServer], bag: Path
) -> None:
    server = start_raw("--bag", str(bag), "--tools", "all")
    server.begin(VERSION)
    exhaust(server)
    check(server)
    said = server.said.decode()
    for what in HIDDEN:  # it was there, and was shown
        assert any(f"U+{ord(character):04X}" in said or f" {ord(character):04X}" in said for character in HIDDEN[what])


@pytest.fixture(scope="module")
def hostile_robot(ros_environment: dict[str, str]) -> Iterator[None]:
    with running(ros_environment, *peer_command("hostile_robot")):
        yield


@pytest.fixture(scope="module")
def server(
    ros_environment: dict[str, str], hostile_robot: None, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[RawServer]:
    """A server that has discovered the hostile robot."""
    server = RawServer(ros_environment, "--tools", "all", "--record-dir", str(tmp_path_factory.mktemp("recordings")))
    server.begin(VERSION)
    until(lambda: "/hostile/basic" in str(server.call("ros2_service_list")), 60.0)  # the first waits for a bridge
    until(lambda: not server.call("ros2_service_call", service_name="/hostile/say", timeout_sec=1)["isError"])
    yield server
    server.end()


def live_calls() -> Iterator[tuple[str, dict[str, Any]]]:
    """Every tool that shows what the robot says."""
    topics = [f"/hostile/{name}" for name in ("text", "texts", "image", "jpeg")]
    for tool in ("ros2_status", "ros2_node_list", "ros2_topic_list", "ros2_service_list", "ros2_list_actions"):
        yield tool, {}
    yield "ros2_health_check", {"expected_topics": topics, "rate_check_duration_sec": 1}
    yield "ros2_node_info", {"node_name": "/hostile"}
    for topic in topics:
        for tool in ("ros2_topic_info", "ros2_topic_echo_wait"):
            yield tool, {"topic_name": topic}
        yield "ros2_topic_subscribe", {"topic_name": topic, "message_limit": 3}
    yield "ros2_topic_subscribe", {"topic_name": "/hostile/text", "message_limit": 60}
    yield "ros2_subscribe_multiple_topics", {"topics": [{"name": topic, "message_limit": 2} for topic in topics]}
    yield "ros2_topic_statistics", {"topic_names": topics, "duration_s": 0.5}
    yield "ros2_topic_stats", {"topic_names": topics, "duration_s": 0.5}
    yield "ros2_wait_until", {"topic_name": "/hostile/text", "condition": 'data != ""'}
    yield "ros2_wait_until", {"topic_name": "/hostile/text", "condition": 'data == ""', "timeout_s": 1.5}
    yield "ros2_topic_compare", {"topic1_name": topics[0], "topic2_name": topics[1], "duration_sec": 1}
    yield "ros2_plot", {"series": ["/hostile/text:data"], "duration_s": 0.5}
    yield "ros2_get_map_as_image", {"topic_name": "/hostile/text", "timeout_s": 1}
    yield "ros2_log_read", {}
    yield "ros2_service_call", {"service_name": "/hostile/say", "fields": []}
    yield "ros2_service_call", {"service_name": "/hostile/basic", "fields": {}, "force_call": True}
    yield "ros2_parameter_list", {}
    yield "ros2_parameter_list", {"node_names": ["/hostile"], "pattern": "name"}
    yield "ros2_parameter_get", {"node_name": "/hostile"}
    yield "ros2_parameter_get", {"node_name": "/hostile", "names": ["nam"]}
    yield "ros2_parameter_set", {"node_name": "/hostile", "values": {"kept": "changed"}}
    yield "ros2_parameter_set", {"node_name": "/hostile", "values": {"kept": "changed"}, "atomic": True}
    yield "ros2_lifecycle_state", {"node_names": ["/hostile"]}
    yield "ros2_lifecycle_change", {"node_name": "/hostile", "transition": "configure"}
    yield "ros2_lifecycle_change", {"node_name": "/hostile", "transition": hostile("tags")}


@pytest.mark.promise("README", "Text of the robot is data: what cannot be seen in it is shown as its code")
def test_a_robot_whose_every_text_is_hostile_forges_nothing(server: RawServer) -> None:
    for tool, arguments in live_calls():
        server.ask("tools/call", name=tool, arguments=arguments, _meta={"progressToken": next(_TOKENS)})
    for uri in ("ros2://graph", "ros2://topics", "ros2://diagnostics", "ros2://log", "ros2://log?level=error"):
        server.ask("resources/read", uri=uri)
    for name in ("text", "texts"):
        uri = f"ros2://topic//hostile/{name}"
        server.ask("resources/subscribe", uri=uri)
        server.ask("resources/read", uri=uri)
    server.ask("resources/read", uri="ros2://node//hostile/parameters")
    for prompt in server.ask("prompts/list")["result"]["prompts"]:
        server.ask("prompts/get", name=prompt["name"], arguments={})
    check(server)
    assert (
        '"isError":false' in server.said.decode().replace(" ", "") and "⟦U+E0001 E0069 E007F⟧" in server.said.decode()
    )


def test_what_was_shown_escaped_and_is_sent_back_reaches_the_robot_as_it_was(server: RawServer) -> None:
    read = server.call("ros2_parameter_get", node_name="/hostile")["structuredContent"]["parameters"]
    assert "⟦U+" in read["kept"]
    text = server.call("ros2_parameter_get", node_name="/hostile")["content"][0]["text"]
    (line,) = [line for line in text.splitlines() if line.startswith("parameters: ")]
    from_text = json.loads(line.removeprefix("parameters: "))
    assert "\u200d" in from_text["kept"], "JSON has an escape for it: who reads it has the robot's own text"
    for values in (read, from_text):
        written = server.call("ros2_parameter_set", node_name="/hostile", values=values)
        assert not written["isError"] and written["structuredContent"]["successful"], written
        fields = {"string_value": values["kept"]}
        arguments = {"service_name": "/hostile/basic", "fields": fields, "force_call": True}
        answered = server.call("ros2_service_call", **arguments)
        assert answered["structuredContent"]["result"]["bool_value"] is True
