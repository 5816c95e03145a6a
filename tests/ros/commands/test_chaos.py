"""Servers that die, come back, reject, abort or do not listen: no call is stuck and every message is right."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress

import pytest

from support.agent import FULL, Refusal
from support.standstill import undisturbed

ROUNDS = 200 if FULL else 2
PROCESSES = 200 if FULL else 1
"""Rounds that start processes."""
LATE_S = 10.0
"""A killed process can hold up the middleware of those that knew it for seconds (decision 12). Judged in full."""
AT_ONCE = 3
"""Such rounds run side by side: while one waits out its time, another discovers its server."""
STILL_WORKING = "The server may still be working on it; give a longer timeout_sec."
NOT_SENT = "nothing was sent"
"""In the error of a call that was held up until its time was over, so that it tells nothing about the server."""
KEPT_S = 1.0
"""How long `forget` keeps a result."""
UNKNOWN_ID = "0123456789abcdef" * 2

pytestmark = pytest.mark.timeout(1800 if FULL else 180)


def side_by_side(one_round: Callable[[], None]) -> None:
    def in_time() -> None:
        for _ in range(4):  # a machine that stalls spoils one try
            with suppress(TooLate):
                return one_round()
        return one_round()

    with ThreadPoolExecutor(AT_ONCE) as lanes:
        for done in [lanes.submit(in_time) for _ in range(PROCESSES)]:
            done.result()


class TooLate(AssertionError):
    """The call ended before what was to happen during it."""


def begin_goal(agent, action: str, order: int, timeout_s: float):
    return agent.begin(
        "ros2_send_action_goal",
        action_name=action,
        goal_fields={"order": order},
        wait_for_result=True,
        timeout_sec=timeout_s,
    )


def begin_call(agent, service: str, timeout_s: float):
    return agent.begin("ros2_service_call", service_name=service, fields={"data": True}, timeout_sec=timeout_s)


def wait_until(condition: Callable[[], object], during: Future[object] | None = None, within_s: float = 30.0) -> None:
    """Wait for something that happens, during a call if one is given."""
    deadline = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < deadline, "it did not happen"
        if during and during.done():
            raise TooLate(f"the call ended first: {during.exception() or during.result()}")
        time.sleep(0.02)


def test_a_service_server_that_is_killed_during_a_call(agent, start_peer) -> None:
    """Killed, it cannot say so, and stays in the graph for a while: the call ends with its time-out."""

    def one_round() -> None:
        peer = start_peer("dumb")
        started, call = time.monotonic(), begin_call(agent, peer.name("mute"), 3.0)
        wait_until(lambda: peer.take(name="mute"), call)
        peer.kill()
        assert str(call.exception(60)) == f"TimedOut: {peer.name('mute')} did not answer within 3 s. {STILL_WORKING}"
        if FULL:
            assert 3.0 <= time.monotonic() - started < 3.0 + LATE_S

    side_by_side(one_round)


def test_a_service_server_that_leaves_during_a_call(agent, start_peer) -> None:
    """Ended with SIGTERM, it says goodbye to ROS: the call ends long before its time is over."""

    def one_round() -> None:
        peer = start_peer("dumb")
        call = begin_call(agent, peer.name("mute"), 50.0)
        wait_until(lambda: peer.take(name="mute"), call)
        peer.terminate()
        left = time.monotonic()
        said = str(call.exception(60))
        assert said.startswith(f"NotFound: The server of {peer.name('mute')} disappeared before it answered.")
        if FULL:
            assert time.monotonic() - left < LATE_S

    side_by_side(one_round)


def test_a_service_server_that_dies_of_a_call(agent, start_peer) -> None:
    def one_round() -> None:
        peer = start_peer("services")
        started, call = time.monotonic(), begin_call(agent, peer.name("fatal"), 1.0)
        said = str(call.exception(60))
        if NOT_SENT in said:
            raise TooLate(said)
        assert said == f"TimedOut: {peer.name('fatal')} did not answer within 1 s. {STILL_WORKING}"
        if FULL:
            assert 1.0 <= time.monotonic() - started < 1.0 + LATE_S

    side_by_side(one_round)


def test_a_service_server_that_never_answers(agent, robot) -> None:
    wait_until(lambda: never_answered_s(agent, robot) < math.inf)


@pytest.mark.full
def test_a_call_that_is_never_answered_ends_within_a_second_of_its_time(agent, robot) -> None:
    for _ in range(ROUNDS):
        assert undisturbed(lambda: never_answered_s(agent, robot)) < 1.0


def never_answered_s(agent, robot) -> float:
    """How long a call took that may take 0.2 s; infinite if these were over before it was sent."""
    started = time.monotonic()
    said = str(begin_call(agent, robot.name("mute"), 0.2).exception(60))
    took = time.monotonic() - started
    if NOT_SENT in said:
        return math.inf
    assert said == f"TimedOut: {robot.name('mute')} did not answer within 0.2 s. {STILL_WORKING}"
    return took


def test_an_action_server_that_is_killed_while_executing_and_started_again(agent, start_peer) -> None:
    """The waiting ends with its time-out; the next server does not know the goal, and takes new ones."""

    def one_round() -> None:
        peer = start_peer("counting")
        action = peer.name("count")
        started, waiting = time.monotonic(), begin_goal(agent, action, 5000, 1.5)
        wait_until(lambda: peer.count(name="count executing"), waiting)
        peer.kill()
        ended = waiting.result(60)
        assert (ended["status"], ended["accepted"], ended["result"]) == ("TIMEOUT", True, None)
        if FULL:
            assert time.monotonic() - started < 1.5 + LATE_S
        again = start_peer("counting", namespace=peer.namespace, is_new=True)
        wait_until(lambda: status(agent, action, ended["goal_id"]) == "UNKNOWN", within_s=60.0)
        assert begin_goal(agent, action, 1, 30.0).result(60)["status"] == "SUCCEEDED"
        again.leave()

    side_by_side(one_round)


def status(agent, action: str, goal_id: str) -> str:
    """Asked briefly: until the new server is discovered, the killed one is asked, which never answers."""
    asked = {"action_name": action, "goal_id_hex": goal_id, "timeout_sec": 0.5}
    try:
        return agent.call("ros2_action_request_result", **asked)["status"]
    except Refusal as refusal:
        assert str(refusal).startswith("NotFound: ")
        return "NOT THERE"


def test_an_action_server_that_leaves_while_executing(agent, start_peer) -> None:
    """Ended with SIGTERM, it says goodbye to ROS: the waiting ends long before its time is over."""

    def one_round() -> None:
        peer = start_peer("raw")
        waiting = begin_goal(agent, peer.name("raw"), 1, 50.0)
        wait_until(lambda: peer.take(name="raw"), waiting)
        peer.terminate()
        left = time.monotonic()
        said = str(waiting.exception(60))
        assert said.startswith(
            f"NotFound: The server of {peer.name('raw')} is not running, or left before the goal ended."
        )
        assert said.endswith(" had been accepted.")
        if FULL:
            assert time.monotonic() - left < LATE_S

    side_by_side(one_round)


@pytest.mark.parametrize(
    "action, status, code",
    [("reject", "NOT_ACCEPTED", -1), ("abort", "ABORTED", 6), ("burst", "SUCCEEDED", 4)],
)
def test_goals_that_end_at_once_one_way_or_the_other(agent, robot, action, status, code) -> None:
    for _ in range(ROUNDS):
        ended = begin_goal(agent, robot.name(action), 1, 30.0).result(50)
        assert (ended["status"], ended["status_code"]) == (status, code)


def test_a_server_that_ignores_cancelling(agent, robot) -> None:
    """It takes the request, and then the goal succeeds all the same: that is what is told."""
    action = robot.name("ignore_cancel")
    for _ in range(ROUNDS):
        sent = agent.call("ros2_send_action_goal", action_name=action, goal_fields={"order": 1})
        cancelled = agent.call("ros2_cancel_action_goal", action_name=action, goal_id_hex=sent["goal_id"])
        assert [goal["goal_id"] for goal in cancelled["goals_canceling"]] == [sent["goal_id"]]
        ended = agent.call("ros2_action_request_result", action_name=action, goal_id_hex=sent["goal_id"])
        assert ended["status"] == "SUCCEEDED"


def test_a_server_that_refuses_cancelling(agent, robot) -> None:
    action = robot.name("refuse_once")
    for _ in range(ROUNDS):
        sent = agent.call("ros2_send_action_goal", action_name=action, goal_fields={"order": 1})
        refused = agent.call("ros2_cancel_action_goal", action_name=action, goal_id_hex=sent["goal_id"])
        assert (refused["goals_canceling"], refused["note"]) == ([], "The server refused to cancel this goal.")
        ended = agent.call("ros2_action_request_result", action_name=action, goal_id_hex=sent["goal_id"])
        assert ended["status"] == "SUCCEEDED"


def test_results_asked_for_twice_at_once_of_unknown_goals_and_of_forgotten_ones(agent, robot) -> None:
    """Of a goal that is kept for a second: who is held up for longer asks for one that has been forgotten."""
    action, goal_ids = robot.name("forget"), []

    def is_told() -> bool:
        goal_id, statuses = asked_at_once(agent, action)
        goal_ids.append(goal_id)
        assert statuses[2] == "UNKNOWN"
        return statuses[:2] == ["SUCCEEDED", "SUCCEEDED"]

    for _ in range(ROUNDS):
        wait_until(is_told)
    wait_until(lambda: result_of(agent, action, goal_ids[-1]).result(60)["status"] == "UNKNOWN")
    for goal_id in goal_ids:
        assert result_of(agent, action, goal_id).result(60)["status"] == "UNKNOWN"


@pytest.mark.full
def test_results_asked_for_at_once_come_while_the_goal_is_kept(agent, robot) -> None:
    def seconds() -> float:
        started = time.monotonic()
        _, statuses = asked_at_once(agent, robot.name("forget"))
        took = time.monotonic() - started
        assert took >= KEPT_S or statuses == ["SUCCEEDED", "SUCCEEDED", "UNKNOWN"]
        return took

    for _ in range(ROUNDS):
        assert undisturbed(seconds) < KEPT_S


def asked_at_once(agent, action: str) -> tuple[str, list[str]]:
    """A new goal, and the statuses when it is asked for twice at once, beside a goal that there never was."""
    goal_id = agent.call("ros2_send_action_goal", action_name=action, goal_fields={"order": 2})["goal_id"]
    asked = [result_of(agent, action, each) for each in (goal_id, goal_id, UNKNOWN_ID)]
    return goal_id, [one.result(60)["status"] for one in asked]


def result_of(agent, action: str, goal_id: str):
    return agent.begin("ros2_action_request_result", action_name=action, goal_id_hex=goal_id, timeout_sec=20)
