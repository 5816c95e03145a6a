"""Resources as a client lists and reads them."""

from __future__ import annotations

from typing import Any

import pytest

from support.agent import until
from support.commanded import CommandedProcess
from support.listener import Listener

SAID = "ros2://topic/events/said"
STATIC = ["graph", "topics", "nodes", "services", "actions", "diagnostics", "log"]
TEMPLATES = ["log{?level,node}", "topic/{+name}", "interface/{+type}", "node/{+name}/parameters"]


def refusal(listener: Listener, uri: str) -> dict[str, Any]:
    """The error that reading must end in."""
    return listener.ask("resources/read", uri=uri)["error"]


def test_every_resource_is_listed_as_json(listener: Listener) -> None:
    assert_listed_as_json(listener)


@pytest.mark.full
def test_every_resource_is_listed_as_json_in_each_era(listener_of_each_era: Listener) -> None:
    assert_listed_as_json(listener_of_each_era)


def assert_listed_as_json(listener: Listener) -> None:
    listed = listener.ask("resources/list")["result"]["resources"]
    templates = listener.ask("resources/templates/list")["result"]["resourceTemplates"]
    assert {entry["uri"] for entry in listed} >= {f"ros2://{path}" for path in STATIC}
    assert {entry["uriTemplate"] for entry in templates} >= {f"ros2://{path}" for path in TEMPLATES}
    assert all(entry["title"] and entry["description"] for entry in (*listed, *templates))
    assert {entry["mimeType"] for entry in (*listed, *templates) if "ros2://" in str(entry)} == {"application/json"}


def test_the_graph_says_who_does_what(listener: Listener) -> None:
    graph = listener.read("ros2://graph")
    peer = next(node for node in graph["nodes"] if node["node"] == "/events_peer")
    assert "/events/said" in peer["publishes"]
    assert peer["actions"] == ["/events/count"]
    assert {"topic_name": "/events/said", "topic_type": "std_msgs/msg/String"} in graph["topics"]


@pytest.mark.parametrize(
    ("path", "key", "expected"),
    [
        ("topics", "topic_name", "/events/said"),
        ("services", "service_name", ""),
        ("actions", "name", "/events/count"),
    ],
)
def test_lists_name_what_there_is(listener: Listener, path: str, key: str, expected: str) -> None:
    entries = [entry[key] for entry in listener.read(f"ros2://{path}")[path]]
    assert not expected or expected in entries


@pytest.mark.parametrize("name", ["events/said", "/events/said", "%2Fevents%2Fsaid"])
def test_a_topic_is_read_however_its_name_is_written(listener: Listener, events: CommandedProcess, name: str) -> None:
    listener.watch(SAID, lambda: events.say(text="hello"))
    topic = listener.read(f"ros2://topic/{name}")
    listener.unsubscribe(SAID)
    assert topic["topic_name"] == "/events/said"
    assert [publisher["node"] for publisher in topic["publishers"]] == ["/events_peer"]
    assert topic["sample"]["message"] == {"data": "hello"}


def test_a_silent_topic_says_so(listener: Listener) -> None:
    topic = listener.read(SAID)
    assert topic["sample"] is None
    assert topic["note"] == "No message came within 2 s from /events_peer."


def test_a_watched_topic_gives_the_very_message_that_was_told_of(listener: Listener, events: CommandedProcess) -> None:
    listener.watch(SAID, lambda: events.say(text="none of these"))
    for text in ("first", "second"):
        listener.update(SAID, events.say(text=text))
        sample = listener.read(SAID)["sample"]
        assert (sample["type"], sample["message"]) == ("std_msgs/msg/String", {"data": text})
    listener.unsubscribe(SAID)


def test_a_definition_is_read_by_its_name(listener: Listener) -> None:
    assert listener.read("ros2://interface/std_msgs/msg/String")["fields"] == {"data": "string"}
    assert listener.read("ros2://interface/std_msgs%2FString")["message_type"] == "std_msgs/msg/String"


def test_parameters_of_a_node_have_values(listener: Listener, events: CommandedProcess) -> None:
    events.tune(value=2.5)
    parameters = listener.read("ros2://node/events_peer/parameters")["parameters"]
    assert next(one["value"] for one in parameters if one["name"] == "speed") == 2.5


def test_the_log_is_read_from_a_level_on_and_the_newest_line_comes_first(
    listener: Listener, events: CommandedProcess
) -> None:
    uri = "ros2://log?level=warn&node=/events_peer"
    listener.watch(uri, lambda: events.log(level="warning", text="getting warm"))
    events.log(level="info", text="all is well")
    listener.update(uri, events.log(level="error", text="too hot"))
    lines = [line["text"] for line in listener.read(uri)["lines"]]
    assert lines[:2] == ["too hot", "getting warm"]
    assert "all is well" not in lines
    listener.unsubscribe(uri)


@pytest.mark.parametrize(
    ("uri", "said"),
    [
        ("ros2://topic/events/sad", "Did you mean /events/said?"),
        ("ros2://node/events_per/parameters", "Did you mean /events_peer?"),
        ("ros2://interface/std_msgs/msg/Strin", "std_msgs/msg/Strin"),
        ("ros2://topic/a%20b", "not a valid topic name"),
        ("ros2://log?level=loud", "There is no level 'loud'"),
        ("ros2://nothing", "ros2://nothing"),
    ],
)
def test_what_is_not_there_is_an_error_that_helps(listener: Listener, uri: str, said: str) -> None:
    error = refusal(listener, uri)
    assert error["code"] == -32602
    assert said in error["message"]


def test_variables_of_templates_are_completed_with_live_names(listener: Listener) -> None:
    def completed(template: str, name: str, typed: str) -> list[str]:
        ref = {"type": "ref/resource", "uri": f"ros2://{template}"}
        wanted = {"ref": ref, "argument": {"name": name, "value": typed}}
        return listener.ask("completion/complete", **wanted)["result"]["completion"]["values"]

    # who types is given nothing where the robot does not answer within a second
    until(lambda: completed("topic/{+name}", "name", "events/s") == ["/events/said"])
    until(lambda: completed("node/{+name}/parameters", "name", "events_p") == ["/events_peer"])
    until(lambda: completed("interface/{+type}", "type", "std_msgs/msg/Stri")[:1] == ["std_msgs/msg/String"])
