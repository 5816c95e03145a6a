"""Goals that are cancelled as soon as a condition holds: on their own feedback, or on any other topic."""

from __future__ import annotations

import os
import re
import signal

import pytest

from support.agent import FULL, Refusal, until
from support.driver import fresh

LONG = 4000
"""Steps of 0.05 s: a goal that would go on for minutes."""
RUNNING = ("ACCEPTED", "EXECUTING")


def send(agent, action: str, condition: str, order: int = LONG, **options):
    goal = {"order": order}
    return agent.call(
        "ros2_send_action_goal", action_name=action, goal_fields=goal, cancel_when=condition, timeout_sec=60, **options
    )


def state(agent, goal_id: str) -> str:
    """Its status; empty while the server has a new bridge, which has yet to discover the action."""
    try:
        goals = agent.call("ros2_action_status")["goals"]
    except Refusal:
        return ""
    return next((goal["status"] for goal in goals if goal["goal_id"] == goal_id), "")


def test_a_goal_is_cancelled_when_its_feedback_meets_a_condition(agent, robot) -> None:
    ended = send(agent, robot.name("count"), "len(sequence) >= 8", wait_for_result=True)
    assert ended["status"] == "CANCELED"
    assert "It was cancelled when len(sequence) >= 8 was met on" in ended["note"]
    met = re.search(r"len\(sequence\) = (\d+)", ended["note"])
    assert met and 8 <= int(met[1]) <= len(ended["result"]["sequence"]) < LONG, ended["note"]
    # The request to cancel leaves within a look at the feedback of 0.01 s: the goal comes no more than a few steps on.
    # A bridge that is held up loses feedback and time, each 20 steps a second.
    if FULL:
        assert int(met[1]) == 8 and len(ended["result"]["sequence"]) < 60


def test_nobody_has_to_wait_for_it(agent, robot) -> None:
    sent = send(agent, robot.name("count"), "len(sequence) >= 8")
    assert sent["accepted"]
    until(lambda: state(agent, sent["goal_id"]) == "CANCELED")
    told = agent.call(
        "ros2_action_request_result", action_name=robot.name("count"), goal_id_hex=sent["goal_id"], timeout_sec=30
    )
    assert "It was cancelled when len(sequence) >= 8 was met" in told["note"]


def test_another_goal_of_the_same_action_goes_on(agent, robot) -> None:
    other = agent.call("ros2_send_action_goal", action_name=robot.name("count"), goal_fields={"order": LONG})
    ended = send(agent, robot.name("count"), "len(sequence) >= 3", wait_for_result=True)
    assert ended["status"] == "CANCELED"
    assert until(lambda: state(agent, other["goal_id"])) in RUNNING  # a status is waited for half a second only
    agent.call("ros2_cancel_action_goal", action_name=robot.name("count"), goal_id_hex=other["goal_id"])


def test_a_goal_that_ends_by_itself_ends_as_ever(agent, robot) -> None:
    ended = send(agent, robot.name("count"), "len(sequence) > 99", order=3, wait_for_result=True)
    assert (ended["status"], ended["result"]) == ("SUCCEEDED", {"sequence": [0, 1, 2]})
    assert "cancelled" not in ended["note"]


def test_a_goal_is_cancelled_when_another_topic_meets_a_condition(agent, robot) -> None:
    topic = fresh("near")

    def publish(value: float) -> None:
        agent.call("ros2_topic_publish", topic_name=topic, message_type="std_msgs/msg/Float64", data={"data": value})

    publish(5.0)
    agent.knows(topic)
    sent = send(agent, robot.name("count"), f"{topic}: data < 0.5")
    publish(5.0)
    assert until(lambda: state(agent, sent["goal_id"])) in RUNNING

    def is_cancelled() -> bool:
        publish(0.25)  # again and again: a new subscription may be discovered late
        return state(agent, sent["goal_id"]) == "CANCELED"

    until(is_cancelled)


def test_a_server_that_refuses_to_cancel_is_told_of(agent, robot) -> None:
    # This goal ends a second after it has refused, however late it is asked to.
    ended = send(agent, robot.name("go_on"), "len(sequence) >= 2", wait_for_result=True)
    assert ended["status"] == "SUCCEEDED"
    assert "Its server refused to cancel it" in ended["note"]


def test_a_condition_that_an_old_message_meets_tells_its_age(agent, robot) -> None:
    """The status of an action is kept for late subscribers, and says nothing new once its goals have ended."""
    other = robot.name("refuse_cancel")
    agent.call("ros2_send_action_goal", action_name=other, goal_fields={"order": 1}, wait_for_result=True)
    ended = send(agent, robot.name("count"), f"{other}/_action/status: len(status_list) > 0", wait_for_result=True)
    assert "was met on" in ended["note"] and "s old, from before; no newer message came" in ended["note"]


@pytest.mark.full
def test_a_bridge_that_is_lost_leaves_the_condition_to_the_next_one(start_agent, robot) -> None:
    agent = start_agent()
    agent.until_answered("ros2_topic_info", topic_name=robot.name("count/_action/status"))
    sent = send(agent, robot.name("count"), "len(sequence) >= 60")  # 3 s
    os.kill(agent.call("ros2_status")["bridge_pid"], signal.SIGKILL)
    until(lambda: state(agent, sent["goal_id"]) == "CANCELED", 60)
    told = agent.call(
        "ros2_action_request_result", action_name=robot.name("count"), goal_id_hex=sent["goal_id"], timeout_sec=30
    )
    assert len(told["result"]["sequence"]) >= 60
    assert "It was cancelled when len(sequence) >= 60 was met" in told["note"]


def test_a_stop_in_the_middle_cancels_it_as_any_goal(agent, robot) -> None:
    sent = send(agent, robot.name("count"), "len(sequence) > 99999")
    assert sent["goal_id"] in str(agent.call("ros2_stop")["goals"])
    until(lambda: state(agent, sent["goal_id"]) == "CANCELED")


@pytest.mark.parametrize(
    ("condition", "says"),
    [
        ("len(sequnce) > 3", "Did you mean sequence?"),
        ("distance_remaining < 1", "Its fields are sequence"),
        ("sequence", "not a condition"),
        ("/not/there: data < 1", "/not/there"),
        ("/rosout: level > 'x'", "Numbers compare with numbers"),
    ],
)
def test_what_cannot_be_asked_is_refused_before_anything_is_sent(agent, robot, condition: str, says: str) -> None:
    before = robot.count(name="count")
    refusal = agent.refusal(
        "ros2_send_action_goal", action_name=robot.name("count"), goal_fields={"order": 3}, cancel_when=condition
    )
    assert says in refusal
    assert robot.count(name="count") == before
