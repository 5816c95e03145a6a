"""A subscriber of either era is told within half a second, and costs nothing when it does not read."""

from __future__ import annotations

import os
import random
import re
import signal
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from support.agent import FULL
from support.commanded import CommandedProcess
from support.listener import MODERN, PATIENCE_S, Listener
from support.raw_server import children
from support.standstill import undisturbed

WITHIN_S = 0.5
TIMES = 20 if FULL else 2
UNREAD_S = 10.0 if FULL else 2.5
SAID = "ros2://topic/events/said"
FAST = "ros2://topic/events/fast"


def delays(listener: Listener, uri: str, event: Callable[[], float]) -> list[float]:
    """How long after each event the push came; events come at random moments."""

    def once() -> float:
        moment = event()
        late = listener.update(uri, moment) - moment
        listener.drain(random.uniform(0.3, 0.6))
        return late

    listener.watch(uri, event)
    listener.drain(0.5)
    late = [undisturbed(once) for _ in range(TIMES)]
    listener.unsubscribe(uri)
    print(f"{uri} {listener.version}: p50 {statistics.median(late):.4f} s, max {max(late):.4f} s")
    return late


def memory(listener: Listener) -> float:
    """The server's resident memory in MB."""
    status = Path(f"/proc/{listener.process.pid}/status").read_text()
    return int(re.search(r"VmRSS:\s+(\d+)", status)[1]) / 1024  # type: ignore[index]


def eventually(condition: Callable[[], bool], within_s: float = PATIENCE_S) -> bool:
    """Whether the condition holds within a time."""
    end = time.monotonic() + within_s
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.05)
    return condition()


@pytest.mark.promise(
    "README",
    "Resources such as ros2://topic/odom or ros2://log can be subscribed to: the client is told when something happens",
)
def test_a_new_sample_is_told(listener_of_each_era: Listener, events: CommandedProcess) -> None:
    assert max(delays(listener_of_each_era, SAID, lambda: events.say(text="hello"))) < WITHIN_S


@pytest.mark.parametrize("uri", ["ros2://nodes", "ros2://graph"])
def test_a_node_that_comes_or_goes_is_told(listener: Listener, events: CommandedProcess, uri: str) -> None:
    assert max(delays(listener, uri, lambda: events.come_or_go(name="guest"))) < WITHIN_S


def test_a_goal_that_ended_is_told(listener: Listener, events: CommandedProcess) -> None:
    goal = {"action_name": "/events/count", "action_type": "test_msgs/action/Fibonacci", "goal_fields": {"order": 1}}

    def reach() -> float:
        listener.call("ros2_send_action_goal", **goal, wait_for_result=True)
        return events.ended()

    assert max(delays(listener, "ros2://actions", reach)) < WITHIN_S


@pytest.mark.promise("README", "can be subscribed to: the client is told when something happens")
def test_a_line_of_at_least_the_level_is_told_and_no_other(listener: Listener, events: CommandedProcess) -> None:
    uri = "ros2://log?level=warn"
    assert max(delays(listener, uri, lambda: events.log(level="warning", text="warm"))) < WITHIN_S
    listener.watch(uri, lambda: events.log(level="error", text="hot"))
    listener.calm()
    events.log(level="info", text="nothing new")
    assert uri not in listener.drain(1.0)
    listener.unsubscribe(uri)


def test_a_diagnostic_that_got_worse_is_told_and_one_that_got_better_is_not(
    listener: Listener, events: CommandedProcess
) -> None:
    uri = "ros2://diagnostics"

    def worsen() -> float:
        events.diagnose(level=0)
        return events.diagnose(level=2)

    assert max(delays(listener, uri, worsen)) < WITHIN_S
    listener.watch(uri, worsen)
    assert [row["level"] for row in listener.read(uri)["components"] if row["name"] == "pump"] == ["ERROR"]
    listener.calm()
    events.diagnose(level=1)
    assert uri not in listener.drain(1.0)
    listener.unsubscribe(uri)


def test_a_parameter_that_was_set_is_told(listener: Listener, events: CommandedProcess) -> None:
    uri = "ros2://node/events_peer/parameters"
    assert max(delays(listener, uri, lambda: events.tune(value=random.random()))) < WITHIN_S


def test_a_topic_that_is_not_there_yet_is_told_when_it_speaks(listener: Listener, events: CommandedProcess) -> None:
    listener.subscribe(FAST)
    moment = events.flood(rate_hz=10, size=10)
    listener.update(FAST, moment)
    listener.unsubscribe(FAST)
    events.flood(rate_hz=0, size=0)


def test_a_fast_topic_is_told_at_most_five_times_a_second(listener: Listener, events: CommandedProcess) -> None:
    listener.subscribe(FAST)
    listener.update(FAST, events.flood(rate_hz=100, size=1000))
    told = undisturbed(lambda: len(listener.drain(2.0)))
    assert 6 <= told <= 11
    listener.unsubscribe(FAST)
    events.flood(rate_hz=0, size=0)


def test_a_lost_bridge_is_survived(listener: Listener, events: CommandedProcess) -> None:
    listener.subscribe(SAID)
    pid = bridge_of(listener)
    moment = time.monotonic()
    os.kill(pid, signal.SIGKILL)
    listener.update(SAID, moment)
    assert bridge_of(listener) != pid
    listener.until_told(SAID, lambda: events.say(text="after the fall"))
    assert listener.read(SAID)["sample"]["message"] == {"data": "after the fall"}
    listener.unsubscribe(SAID)


def bridge_of(listener: Listener) -> int:
    """The process of the server's bridge."""
    return children(listener.process.pid)[0]


@pytest.mark.full
def test_a_hundred_subscriptions_leave_nothing_behind(listener: Listener, events: CommandedProcess) -> None:
    def subscriptions() -> int:
        return events.subscribers(topic="/events/said")

    for _ in range(100):
        listener.subscribe(SAID)
        listener.unsubscribe(SAID)
    assert eventually(lambda: subscriptions() == 0)
    listener.subscribe(SAID)
    assert eventually(lambda: subscriptions() == 1)
    listener.unsubscribe(SAID)
    assert eventually(lambda: subscriptions() == 0)
    events.say(text="unheard")
    assert listener.drain(0.5) == []


def test_what_is_not_ours_is_not_subscribed_to(listener_of_each_era: Listener) -> None:
    listener = listener_of_each_era
    if listener.version != MODERN:
        error = listener.ask("resources/subscribe", uri="ros2://nothing")["error"]
        assert (error["code"], error["data"]) == (-32602, {"uri": "ros2://nothing"})
        return
    request = listener.send("subscriptions/listen", notifications={"resourceSubscriptions": [SAID, "ros2://nothing"]})
    acknowledged = listener.wait_for_line("notifications/subscriptions/acknowledged", request)
    assert acknowledged["params"]["notifications"] == {"resourceSubscriptions": [SAID]}
    listener.tell("notifications/cancelled", requestId=request)


@pytest.mark.alone
def test_a_client_that_does_not_read_costs_little_and_is_told_once_when_it_reads_again(
    listener: Listener, events: CommandedProcess
) -> None:
    listener.subscribe(FAST)
    listener.update(FAST, events.flood(rate_hz=100, size=200_000))
    listener.read(FAST)
    listener.ask("tools/list")

    listener.drain(1.0)
    before = memory(listener)
    unread = [listener.send("tools/list") for _ in range(10)]  # more than a pipe holds
    most, end = 0.0, time.monotonic() + UNREAD_S
    while time.monotonic() < end:
        time.sleep(0.25)  # nothing is read
        most = max(most, memory(listener))
    told = len(listener.updates)
    for request in unread:
        listener.answer(request)
    print(f"{listener.version}: {most - before:.1f} MB")
    assert most - before < 20.0
    assert 1 <= len(listener.updates) - told <= 6, "pushes must not have piled up"
    listener.unsubscribe(FAST)
    events.flood(rate_hz=0, size=0)
