"""A service call that means something else is that: a goal is known to `ros2_stop`, whichever tool sent it."""

from __future__ import annotations

import time
import uuid

import pytest

from support.agent import until
from support.raw_server import MODERN


def call(agent, service: str, kind: str, fields: dict[str, object], **options):
    return agent.call("ros2_service_call", service_name=service, service_type=kind, fields=fields, **options)


def send_raw(agent, action: str, order: int) -> str:
    goal_id = uuid.uuid4()
    fields = {"goal_id": {"uuid": list(goal_id.bytes)}, "goal": {"order": order}}
    sent = call(agent, f"{action}/_action/send_goal", "", fields)
    assert (sent["called"], sent["service_type"]) == (True, "test_msgs/action/Fibonacci_SendGoal")
    assert sent["result"]["accepted"] is True
    return goal_id.hex


def wait_until(condition, within_s: float = 30.0) -> None:
    deadline = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < deadline, "it did not happen"
        time.sleep(0.05)


@pytest.mark.promise("README", "goals that it sent cancelled")
@pytest.mark.promise("ros2_action_status", "List every goal of every action with its state and age")
def test_a_goal_that_was_sent_by_a_raw_call_is_ours_and_stopped(agent, robot) -> None:
    action = robot.name("count")
    goal_id = send_raw(agent, action, 2000)
    known = until(lambda: [g for g in agent.call("ros2_action_status")["goals"] if g["goal_id"] == goal_id])
    assert [goal["from_this_server"] for goal in known] == [True]
    stopped = [goal for goal in agent.call("ros2_stop")["goals"] if goal["goal_id"] == goal_id]
    assert [(g["action_name"], g["status"], g["confirmed"]) for g in stopped] == [(action, "CANCELED", True)]


@pytest.mark.promise("stopping", "as when the server ends: zeros, goals cancelled")
def test_a_goal_of_a_raw_call_is_cancelled_when_the_server_dies(start_raw, robot) -> None:
    server = start_raw()
    server.begin(MODERN)
    action, cancelled = robot.name("count"), robot.count(name="canceled")
    listed = {"pattern": action}
    wait_until(lambda: server.call("ros2_list_actions", **listed)["structuredContent"]["actions"])
    fields = {"goal_id": {"uuid": list(uuid.uuid4().bytes)}, "goal": {"order": 2000}}
    raw = {"service_name": f"{action}/_action/send_goal", "fields": fields}
    assert server.call("ros2_service_call", **raw)["structuredContent"]["result"]["accepted"]
    server.process.kill()
    wait_until(lambda: robot.count(name="canceled") > cancelled)


def test_a_raw_goal_needs_an_id_by_which_it_can_be_cancelled(agent, robot) -> None:
    service = f"{robot.name('count')}/_action/send_goal"
    text = agent.refusal("ros2_service_call", service_name=service, fields={"goal": {"order": 1}}, force_call=True)
    assert text.startswith("BadValue: goal_id.uuid: ")
    assert "16 random bytes" in text


def test_a_raw_cancel_request_cancels(agent, robot) -> None:
    action = robot.name("count")
    goal_id = send_raw(agent, action, 2000)
    info = {"goal_id": {"uuid": list(bytes.fromhex(goal_id))}, "stamp": {"sec": 0, "nanosec": 0}}
    answer = call(agent, f"{action}/_action/cancel_goal", "action_msgs/srv/CancelGoal", {"goal_info": info})
    assert answer["result"]["return_code"] == 0
    assert [bytes(g["goal_id"]["uuid"]).hex() for g in answer["result"]["goals_canceling"]] == [goal_id]
    ended = agent.call("ros2_action_request_result", action_name=action, goal_id_hex=goal_id)
    assert ended["status"] == "CANCELED"


def test_parameters_are_set_by_raw_calls_and_checked_like_any_request(agent, robot) -> None:
    node = robot.name("tuned")
    kinds = {"set_parameters": "SetParameters", "set_parameters_atomically": "SetParametersAtomically"}
    for label, (service, kind) in zip("ab", kinds.items(), strict=True):
        parameter = {"name": "label", "value": {"type": 4, "string_value": label}}
        raw = call(agent, f"{node}/{service}", f"rcl_interfaces/srv/{kind}", {"parameters": [parameter]})
        results = raw["result"].get("results") or [raw["result"]["result"]]
        assert [result["successful"] for result in results] == [True]
        read = agent.call("ros2_parameter_get", node_name=node, names=["label"])
        assert read["parameters"]["label"] == label
    text = agent.refusal(
        "ros2_service_call", service_name=f"{node}/set_parameters", fields={"parameters": [{"title": "label"}]}
    )
    assert text.startswith("BadValue: parameters[0].title: ")
    assert agent.call("ros2_parameter_set", node_name=node, values={"label": "3"})["successful"]


def test_a_transition_is_made_by_a_raw_call(agent, robot) -> None:
    node = robot.name("valve")
    before = agent.call("ros2_lifecycle_state", node_names=[node])["nodes"][0]["state"]
    assert before == "unconfigured"
    for label, state in (("configure", "inactive"), ("cleanup", "unconfigured")):
        raw = call(agent, f"{node}/change_state", "", {"transition": {"id": 0, "label": label}})
        assert raw["result"] == {"success": True}
        assert agent.call("ros2_lifecycle_state", node_names=[node])["nodes"][0]["state"] == state
