"""*Confirmed* is said only of what was looked at. That stop is offered whenever anything that acts is:
`tests/unit/test_composition.py`.
"""

from __future__ import annotations

import re
from contextlib import suppress

import pytest

from support.agent import Refusal, until
from support.driver import WAYS, calm, fresh

SET_BOOL = "std_srvs/srv/SetBool"


def listed(server) -> dict[str, dict]:
    return {tool["name"]: tool for tool in server.ask("tools/list")["result"]["tools"]}


def test_stopping_is_not_declared_destructive(server) -> None:
    annotations = listed(server)["ros2_stop"]["annotations"]
    assert annotations["destructiveHint"] is False
    assert annotations["idempotentHint"] is True
    assert not annotations.get("readOnlyHint")


def test_names_of_jobs_cannot_be_guessed(server, observer) -> None:
    ids = []
    for _ in range(3):
        topic = fresh("guess")
        ids.append(server.result(WAYS["relay"](server, observer, topic))["relay_id"])
        ids.append(server.result(WAYS["playback"](server, observer, topic + "_too"))["playback_id"])
        calm(observer, topic)
    server.stop()
    parts = [re.search(r"[0-9a-z]{8,}$", job.lower()) for job in ids]
    assert all(parts), ids
    assert len({part[0] for part in parts}) == len(ids)
    assert any(set("abcdefghijklmnopqrstuvwxyz") & set(part[0]) for part in parts), ids


def test_a_service_that_only_reads_hinders_nothing(server, observer) -> None:
    node = until(lambda: next((n for n in server.do("ros2_node_list")["nodes"] if "observer" in n), None))
    server.do("ros2_parameter_list", node_names=[node])
    asked = {"service_name": f"{node}/list_parameters", "fields": {"prefixes": [], "depth": 0}}
    server.do("ros2_service_call", **asked, force_call=True)
    stopped = server.stop()[0]
    assert "unknown_services" not in stopped and "NOT judged" not in stopped["note"]


def test_a_goal_that_was_sent_as_a_raw_call(server, observer) -> None:
    """It is known to ros2_stop as every other, which cancels it."""
    action = fresh("raw")
    observer.act(action=action)
    until(lambda: action in str(server.do("ros2_list_actions")))
    goal = {"goal_id": {"uuid": list(range(1, 17))}, "goal": {"order": 6000}}
    with suppress(
        Refusal
    ):  # its answer may get lost, where its server knows the client late; the goal has come all the same
        server.do("ros2_service_call", service_name=f"{action}/_action/send_goal", fields=goal)
    until(lambda: observer.goals_of(action=action))
    stopped = server.stop()[0]
    assert [one["action_name"] for one in stopped["goals"]] == [action]
    assert stopped["goals"][0]["confirmed"]
    until(lambda: [one["status"] for one in observer.goals_of(action=action)] == ["canceled"])


@pytest.mark.promise("README", "Services that were called, and topics of other types that were published on, are named")
@pytest.mark.promise("ros2_stop", "which called services and published topics it cannot stop")
@pytest.mark.promise("stopping", "this server has called a service or published on a topic of another type since")
def test_a_service_that_was_called_is_named_and_not_confirmed(server, observer) -> None:
    """The last that uses the server of this file: from then on it cannot confirm a stop."""
    service = fresh("open_gripper")
    observer.serve(service=service, kind=SET_BOOL)
    until(lambda: service in str(server.do("ros2_service_list")))
    assert "NOT judged" not in server.stop()[0]["note"]  # reading services confirms nothing and hides nothing

    def is_called() -> bool:
        with suppress(Refusal):  # its answer may get lost: the server may not have discovered the client yet
            return server.do("ros2_service_call", service_name=service, fields={"data": True})["called"]
        return False

    until(is_called, 60.0)
    answer = server.call("ros2_stop")
    assert answer["structuredContent"]["confirmed"] is False
    assert service in answer["content"][0]["text"]


@pytest.mark.promise("README", "topics of other types that were published on, are named")
@pytest.mark.promise("stopping", "and names them (unknown_services, unknown_topics)")
def test_a_type_of_which_nobody_knows_how_it_is_stopped(start_server, observer) -> None:
    topic, server = fresh("effort"), start_server()
    observer.join(by=topic, topic=topic, kind="std_msgs/msg/Float64")
    server.knows(topic, 1)
    server.do("ros2_topic_publish", topic_name=topic, data={"data": 1.0})
    answer = server.call("ros2_stop")
    assert answer["structuredContent"]["confirmed"] is False
    assert topic in answer["content"][0]["text"]


@pytest.mark.promise("stopping", "or a goal's server does not answer")
@pytest.mark.promise("README", "every goal has ended")
def test_a_goal_whose_server_has_not_answered_is_not_confirmed(start_server, observer) -> None:
    """The server judges for longer than ros2_stop waits: who looks away says so."""
    action, server = fresh("ponders"), start_server()
    observer.act(action=action, think_s=15.0)
    until(lambda: action in str(server.do("ros2_list_actions")))
    server.tool("ros2_send_action_goal", action_name=action, goal_fields={"order": 100})
    until(lambda: observer.goals_of(action=action))
    assert server.stop()[0]["confirmed"] is False
