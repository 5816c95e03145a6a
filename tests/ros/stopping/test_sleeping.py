"""A server that is stopped (SIGSTOP) cannot stop what it moves: the bridge does when the link lease lapses."""

from __future__ import annotations

import json
import signal
import time
from collections.abc import Iterator
from contextlib import suppress

import pytest

from support.agent import FULL, Refusal, until
from support.driver import WAYS, calm, fresh, going_on, until_driven
from support.standstill import undisturbed

ROUNDS = 200
LEASE_S = 1.0
LIMIT_S = LEASE_S + 0.1
GOAL_S = LIMIT_S + 0.3
"""A goal is cancelled by a call, and its server looks every 20 ms whether it is."""
AWAKE_S = 0.5
"""What a server does when it is continued, it does at once."""

pytestmark = pytest.mark.timeout(1800 if FULL else 300)


@pytest.fixture(autouse=True)
def awake(server) -> Iterator[None]:
    """Whatever a test saw, the next one gets a server that runs and moves nothing."""
    yield
    server.process.send_signal(signal.SIGCONT)
    server.stop()


@pytest.fixture(scope="module")
def action(server, observer) -> str:
    """An action that the server knows, with goals that last five minutes."""
    name = fresh("far")
    observer.act(action=name)
    until(lambda: name in str(server.do("ros2_list_actions")))
    return name


class Round:
    """A server that moves the robot in every way at once, and is then stopped."""

    def __init__(self, server, observer, action: str) -> None:
        self.server, self.observer, self.action = server, observer, action
        self.topics = {way: fresh(f"asleep_{way}") for way in WAYS}
        for topic in self.topics.values():
            observer.join(by=topic, topic=topic, kind="geometry_msgs/msg/Twist")
            observer.join(by=f"{topic} lossy", topic=topic, kind="geometry_msgs/msg/Twist", best_effort=True)
        server.knows(topic, 2)
        goal = {"action_name": self.action, "goal_fields": {"order": 3000}, "wait_for_result": True}
        self.goal = server.tool("ros2_send_action_goal", **goal, timeout_sec=300)
        self.requests = {way: WAYS[way](server, observer, topic) for way, topic in self.topics.items()}
        for way, topic in self.topics.items():
            of = 1 if way == "once" else 2  # what is said once may escape the lossy one
            self.requests[way] = until_driven(server, observer, way, topic, self.requests[way], of)
        until(lambda: [one["status"] for one in observer.goals_of(action=self.action)] == ["running"])
        self.requests["drive"] = going_on(server, observer, self.topics["drive"], self.requests["drive"])

    def stop(self) -> None:
        """Stops the server, and waits until everything has stopped that it moved."""
        self.stopped_ns, self.stopped_unix_ns = time.monotonic_ns(), time.time_ns()
        self.server.process.send_signal(signal.SIGSTOP)
        for topic in self.topics.values():
            self.observer.until_stopped(topic, self.stopped_unix_ns)
        until(lambda: self._goal_s() < float("inf"))

    def drove_s(self) -> dict[str, float]:
        """How long each way drove on, in seconds: until its zero had left."""
        return {way: self._drove_s(topic) for way, topic in self.topics.items()} | {"goal": self._goal_s()}

    def is_at_rest(self) -> None:
        """Nothing has moved the robot after its zero."""
        for topic in self.topics.values():
            assert self.observer.unstopped(topic=topic, since=self.stopped_unix_ns) == [], "it moves again"

    def go_on(self) -> int:
        """Continues it; returns when."""
        at_ns = time.monotonic_ns()
        self.server.process.send_signal(signal.SIGCONT)
        return at_ns

    def end(self) -> None:
        self.server.stop()
        for topic in self.topics.values():
            calm(self.observer, topic)
            self.observer.leave(by=topic)
            self.observer.leave(by=f"{topic} lossy")

    def _drove_s(self, topic: str) -> float:
        if self.observer.moving(topic=topic):
            return float("inf")
        heard = self.observer.messages(topic=topic)
        last_move = max(one["sent"] for one in heard if any(one["values"]))
        zero = min(one["sent"] for one in heard if one["sent"] > last_move)
        return (zero - self.stopped_ns) / 1e9

    def _goal_s(self) -> float:
        (goal,) = self.observer.goals_of(action=self.action)
        return (goal["ended"] - self.stopped_ns) / 1e9 if goal["status"] == "canceled" else float("inf")


@pytest.mark.full
@pytest.mark.promise("README", "is stopped or sleeps (within 1.1 s)")
@pytest.mark.promise("stopping", "the server is stopped (SIGSTOP), hangs, or its machine sleeps")
def test_a_server_that_is_stopped_leaves_nothing_moving_for_longer_than_its_lease(server, observer, action) -> None:
    worst: dict[str, float] = {}

    def drove() -> dict[str, float]:
        observer.forget()
        one = Round(server, observer, action)
        one.stop()
        time.sleep(0.1)  # a zero that is followed by a motion ends nothing
        took = one.drove_s()
        continued_ns = one.go_on()
        time.sleep(AWAKE_S)
        for topic in one.topics.values():
            assert observer.moved(sent_after=continued_ns, topic=topic) == [], "it moves again"
        for request in (*one.requests.values(), one.goal):
            server.outcome(request)
        one.end()
        return took

    for number in range(ROUNDS):
        took = undisturbed(drove)
        worst = {way: max(took[way], worst.get(way, 0.0)) for way in took}
        print(number + 1, "rounds, at most", {way: round(seconds, 3) for way, seconds in worst.items()}, flush=True)
        assert took.pop("goal") <= GOAL_S
        assert max(took.values()) <= LIMIT_S, took


@pytest.mark.promise("README", "everything that was driven when the server dies, is stopped or sleeps")
@pytest.mark.promise("stopping", "the server is stopped (SIGSTOP), hangs, or its machine sleeps")
@pytest.mark.promise("stopping", "when it goes on, its calls say what ended them")
def test_a_server_that_is_stopped_leaves_nothing_moving_and_says_so_when_it_goes_on(server, observer, action) -> None:
    """While it is stopped, every way in which it drove has its zero and its goal is cancelled; then nothing moves."""
    observer.forget()
    one = Round(server, observer, action)
    one.stop()
    one.is_at_rest()
    one.go_on()
    assert "lease" in server.outcome(one.requests["repeat"])
    goal = server.outcome(one.goal)
    assert "CANCELED" in goal and "longer than the link lease" in goal
    assert "lease" in json.dumps(server.do("ros2_status"))
    relays = server.do("ros2_relay_list")["relays"]
    driven = {one.topics["relay"], one.topics["feed"]}
    ended = [relay for relay in relays if relay["destination_topic"] in driven]
    assert [(relay["state"], "link lease" in relay["note"]) for relay in ended] == [("stopped", True)] * 2, ended
    playback_id = server.result(one.requests["playback"])["playback_id"]
    (playback,) = server.do("ros2_bag_play_status", playback_id=playback_id)["playbacks"]
    assert playback["state"] == "stopped" and "link lease" in playback["note"], playback
    server.outcome(one.requests["once"])
    drove = server.outcome(one.requests["drive"])
    # A busy machine can make its odometry silent first.
    assert "link lease" in drove or "has sent nothing" in drove, drove
    one.is_at_rest()
    one.end()


def test_a_server_that_was_stopped_drives_again_when_it_is_asked_anew(server, observer) -> None:
    topic = fresh("again")
    observer.watch(topic)
    server.knows(topic, 4)
    first = WAYS["repeat"](server, observer, topic)
    observer.until_driven(topic, 3, of=4)
    since_ns = time.time_ns()
    server.process.send_signal(signal.SIGSTOP)
    observer.until_stopped(topic, since_ns, full_s=3 * LEASE_S)
    server.process.send_signal(signal.SIGCONT)
    with suppress(Refusal):
        server.result(first)
    observer.forget()
    WAYS["repeat"](server, observer, topic)
    observer.until_driven(topic, 10, of=4)
    since_ns = time.time_ns()
    server.stop()
    observer.until_stopped(topic, since_ns, full_s=1.0)


def test_what_was_asked_of_a_server_that_sleeps_is_done_when_it_wakes_and_not_twice(server, observer) -> None:
    """It was accepted only then: nothing that is older than the lease is hidden in it."""
    topic, driven = fresh("queued"), fresh("driven")
    for each in (topic, driven):
        observer.join(by=each, topic=each, kind="geometry_msgs/msg/Twist")
        server.knows(each, 1)
    WAYS["repeat"](server, observer, driven)
    observer.until_driven(driven)
    since_ns = time.time_ns()
    server.process.send_signal(signal.SIGSTOP)
    sent = WAYS["once"](server, observer, topic)
    observer.until_stopped(driven, since_ns)  # the lease has lapsed
    assert observer.counts(topic=topic)[topic] == 0
    server.process.send_signal(signal.SIGCONT)
    server.outcome(sent)
    assert observer.driven(topic=topic)[topic] <= 1
    server.stop()
