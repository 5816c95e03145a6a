"""A subscriber of either era is told, and costs nothing when it does not read."""

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

from support.agent import FULL, until
from support.commanded import CommandedProcess
from support.listener import MODERN, UPDATED, Listener
from support.raw_server import children
from support.standstill import undisturbed

WITHIN_S = 0.5
TIMES = 20
UNREAD = 1000 if FULL else 250
"""Messages of a flood at 100 Hz while a client does not read."""
FLOOD_S = 60.0
"""Far longer than they take."""
SAID = "ros2://topic/events/said"
FAST = "ros2://topic/events/fast"
GOAL = {"action_name": "/events/count", "action_type": "test_msgs/action/Fibonacci", "goal_fields": {"order": 1}}


def reach(listener: Listener, events: CommandedProcess) -> float:
    listener.call("ros2_send_action_goal", **GOAL, wait_for_result=True)
    return events.ended()


def worsen(_: Listener, events: CommandedProcess) -> float:
    events.diagnose(level=0)
    return events.diagnose(level=2)


EVENTS: dict[str, Callable[[Listener, CommandedProcess], float]] = {
    SAID: lambda _, events: events.say(text="hello"),
    "ros2://nodes": lambda _, events: events.come_or_go(name="guest"),
    "ros2://graph": lambda _, events: events.come_or_go(name="guest"),
    "ros2://actions": reach,
    "ros2://log?level=warn": lambda _, events: events.log(level="warning", text="warm"),
    "ros2://diagnostics": worsen,
    "ros2://node/events_peer/parameters": lambda _, events: events.tune(value=random.random()),
}
"""What happens to each resource; when it happened."""


def memory(listener: Listener) -> float:
    """The server's resident memory in MB."""
    status = Path(f"/proc/{listener.process.pid}/status").read_text()
    return int(re.search(r"VmRSS:\s+(\d+)", status)[1]) / 1024  # type: ignore[index]


@pytest.mark.promise(
    "README",
    "Resources such as ros2://topic/odom or ros2://log can be subscribed to: the client is told when something happens",
)
def test_a_new_sample_is_told_in_each_era(listener_of_each_era: Listener, events: CommandedProcess) -> None:
    assert_told(listener_of_each_era, events, SAID)


@pytest.mark.promise("README", "can be subscribed to: the client is told when something happens")
@pytest.mark.parametrize("uri", list(EVENTS)[1:])
def test_what_happens_is_told(listener: Listener, events: CommandedProcess, uri: str) -> None:
    assert_told(listener, events, uri)


def assert_told(listener: Listener, events: CommandedProcess, uri: str) -> None:
    """What happens when all that has happened before has been told is told, too."""
    listener.watch(uri, lambda: EVENTS[uri](listener, events))
    listener.calm()
    listener.update(uri, EVENTS[uri](listener, events))
    listener.unsubscribe(uri)


@pytest.mark.full
@pytest.mark.parametrize("uri", EVENTS)
def test_it_is_told_within_half_a_second(listener_of_each_era: Listener, events: CommandedProcess, uri: str) -> None:
    """Events come at random moments."""
    listener = listener_of_each_era

    def once() -> float:
        moment = EVENTS[uri](listener, events)
        late = listener.update(uri, moment) - moment
        listener.drain(random.uniform(0.3, 0.6))
        return late

    listener.watch(uri, lambda: EVENTS[uri](listener, events))
    listener.drain(0.5)
    late = [undisturbed(once) for _ in range(TIMES)]
    listener.unsubscribe(uri)
    print(f"{uri} {listener.version}: p50 {statistics.median(late):.4f} s, max {max(late):.4f} s")
    assert max(late) < WITHIN_S


@pytest.mark.promise("README", "can be subscribed to: the client is told when something happens")
def test_a_line_below_the_level_is_not_told(listener: Listener, events: CommandedProcess) -> None:
    def is_known() -> bool:
        return "nothing new" in str(listener.read("ros2://log?level=info&node=/events_peer"))

    def happens() -> None:
        events.log(level="info", text="nothing new")
        until(is_known)

    assert_not_told(listener, events, "ros2://log?level=warn", happens)


def test_a_diagnostic_that_got_better_is_not_told(listener: Listener, events: CommandedProcess) -> None:
    def level() -> str:
        (pump,) = (row for row in listener.read("ros2://diagnostics")["components"] if row["name"] == "pump")
        return pump["level"]

    def happens() -> None:
        assert level() == "ERROR"
        events.diagnose(level=1)
        until(lambda: level() == "WARN")

    assert_not_told(listener, events, "ros2://diagnostics", happens)


def assert_not_told(listener: Listener, events: CommandedProcess, uri: str, happens: Callable[[], None]) -> None:
    """What happens is not told: the server knows it, and what happens to another resource afterwards is told."""
    for each in (SAID, uri):
        listener.watch(each, lambda each=each: EVENTS[each](listener, events))
    listener.calm()
    told = len(listener.updates)
    happens()
    listener.update(SAID, events.say(text="later"))
    assert uri not in [pushed for pushed, _ in listener.updates[told:]]
    for each in (SAID, uri):
        listener.unsubscribe(each)


def test_a_topic_that_is_not_there_yet_is_told_when_it_speaks(listener: Listener, events: CommandedProcess) -> None:
    listener.subscribe(FAST)
    moment = events.flood(rate_hz=10, size=10)
    listener.update(FAST, moment)
    listener.unsubscribe(FAST)
    events.flood(rate_hz=0, size=0)


def test_a_fast_topic_is_told_again_and_again_but_not_of_each_message(
    listener: Listener, events: CommandedProcess
) -> None:
    listener.subscribe(FAST)
    listener.update(FAST, events.flood(rate_hz=100, size=1000))
    _, began = events.flooded()
    listener.drain(0.0)  # what was told before that
    told = len(listener.updates)
    until(lambda: listener.drain(0.1) is not None and len(listener.updates) >= told + 10)
    _, ended = events.flooded()
    assert 10 <= len(listener.updates) - told <= 1 + 5 * (ended - began)
    listener.unsubscribe(FAST)
    events.flood(rate_hz=0, size=0)


@pytest.mark.full
def test_a_fast_topic_is_told_five_times_a_second(listener: Listener, events: CommandedProcess) -> None:
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
    until(lambda: children(listener.process.pid)[:1] not in ([], [pid]))
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
    until(lambda: subscriptions() == 0)
    listener.subscribe(SAID)
    until(lambda: subscriptions() == 1)
    listener.unsubscribe(SAID)
    until(lambda: subscriptions() == 0)
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


def test_a_client_that_does_not_read_costs_little_and_is_told_once_when_it_reads_again(
    listener: Listener, events: CommandedProcess
) -> None:
    listener.subscribe(FAST)
    listener.update(FAST, events.flood(rate_hz=100, size=200_000))
    listener.read(FAST)
    listener.ask("tools/list")

    steady = events.flooded()[0] + 100
    until(lambda: listener.drain(0.1) is not None and events.flooded()[0] >= steady)
    before = memory(listener)
    unread = [listener.send("tools/list") for _ in range(10)]  # more than a pipe holds
    most, until_sent = 0.0, events.flooded()[0] + UNREAD

    def is_sent() -> bool:
        """Nothing is read meanwhile."""
        nonlocal most
        most = max(most, memory(listener))
        return events.flooded()[0] >= until_sent

    until(is_sent, FLOOD_S)
    events.flood(rate_hz=0, size=0)
    for request in unread:
        listener.answer(request)
    listener.ask("tools/list")
    print(f"{listener.version}: {most - before:.1f} MB")
    assert most - before < 20.0
    lines = listener.lines()
    filled = next(number for number, line in enumerate(lines) if line.get("id") == unread[1])  # the pipe, by then
    pushes = [line for line in lines[filled:] if line.get("method") == UPDATED]
    assert 1 <= len(pushes) <= 6, "pushes must not have piled up"
    listener.unsubscribe(FAST)
