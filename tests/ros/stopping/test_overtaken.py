"""After `ros2_stop` was answered nothing leaves that was accepted before it: 2 rounds of each race, 200 in full."""

from __future__ import annotations

import os
import random
import signal
import time
from collections.abc import Callable
from contextlib import suppress

import pytest

from support.agent import FULL, Refusal, until
from support.driver import MOVING, WAYS, Driver, calm, fresh
from support.observer import Observer
from support.velocities import TWIST, speed

ROUNDS = 200 if FULL else 2
BRIDGES = 50 if FULL else 1
"""Each takes a bridge two seconds to come up."""
LATEST_S = 0.05
"""A request shows only when it arrives: the way through DDS and the observer's threads takes less on two processors."""
REST_S = 1.0 if FULL else 30.0
ACTION_S = 3.0 if FULL else 30.0
"""A goal is judged for 0.2 s and looks for its cancelling every 20 ms."""

Way = Callable[[Driver, Observer, str], int]

pytestmark = pytest.mark.timeout(1500 if FULL else 300)


@pytest.fixture
def chance(request: pytest.FixtureRequest) -> random.Random:
    return random.Random(request.node.name)


@pytest.fixture
def watched(server, observer) -> str:
    """A topic with four subscribers that the server knows."""
    topic = fresh("watched")
    observer.watch(topic)
    server.knows(topic, 4)
    return topic


def has_ended(server: Driver, observer: Observer, topic: str, answered_ns: int) -> None:
    """Nothing moves the robot that was written after the answer, and every subscriber is at rest.

    What left late has come when a zero has that the same server publishes now, after all of it.
    """
    assert observer.comes_to_rest(topic, REST_S) == [], "the stop has sent the zero, not this test"
    since_ns = time.time_ns()

    def has_zero() -> bool:
        """Who has just joined may not be discovered yet, as by a new bridge: then it is published again."""
        with suppress(Refusal):
            server.do("ros2_topic_publish", topic_name=topic, message_type=TWIST, data=speed(TWIST, 0.0))
        return not observer.behind(topic=topic, since=since_ns)

    until(has_zero, 60.0)
    until(lambda: not observer.moving(topic=topic))
    assert observer.moved(sent_after=answered_ns, topic=topic) == []


@pytest.mark.promise("ros2_stop", "commands accepted earlier but not yet sent are dropped")
@pytest.mark.promise("stopping", "nothing is sent any more that was accepted before")
def test_publishes_that_are_in_flight(server, observer, watched, chance) -> None:
    for _ in range(ROUNDS):
        sent = [WAYS["once"](server, observer, watched) for _ in range(20)]
        time.sleep(chance.uniform(0.0, 0.03))
        _, answered_ns = server.stop()
        for request in sent:
            server.outcome(request)
        has_ended(server, observer, watched, answered_ns)


def untyped(server: Driver, _: Observer, topic: str) -> int:
    """One message whose type is still to be resolved."""
    return server.tool("ros2_topic_publish", topic_name=topic, data=speed(TWIST, MOVING))


@pytest.mark.parametrize("publish", [WAYS["once"], WAYS["repeat"], untyped])
def test_a_publish_that_waits_for_its_subscriber(server, observer, chance, publish: Way) -> None:
    for _ in range(ROUNDS):
        topic = fresh("waits")
        sent = publish(server, observer, topic)
        time.sleep(chance.uniform(0.0, 0.2))
        _, answered_ns = server.stop()
        observer.join(by=topic, topic=topic, kind=TWIST)
        server.outcome(sent)
        has_ended(server, observer, topic, answered_ns)
        observer.leave(by=topic)


def test_a_call_that_waits_for_its_server(server, observer, chance) -> None:
    for _ in range(ROUNDS):
        service = fresh("appears")
        asked = {"service_name": service, "service_type": "std_srvs/srv/SetBool", "fields": {"data": True}}
        sent = server.tool("ros2_service_call", **asked, timeout_sec=3)
        time.sleep(chance.uniform(0.0, 0.2))
        server.stop()
        observer.serve(service=service, kind="std_srvs/srv/SetBool")
        server.outcome(sent)
        # What left late has come before this one. Its answer may get lost: Fast DDS gives an answer up that a busy
        # machine's client is not ready for.
        server.outcome(server.tool("ros2_service_call", **asked, timeout_sec=30))
        until(lambda service=service: observer.asked(service=service))
        assert len(observer.asked(service=service)) == 1


def test_a_call_that_waits_for_its_server_ends_by_the_stop_and_not_by_its_time(server) -> None:
    asked = {"service_name": fresh("never"), "service_type": "std_srvs/srv/SetBool", "fields": {"data": True}}
    sent = server.tool("ros2_service_call", **asked, timeout_sec=30)
    server.stop()
    with pytest.raises(Refusal, match="Stopped: "):
        server.result(sent)


@pytest.mark.full
def test_a_call_that_waits_for_its_server_ends_at_once(server) -> None:
    asked = {"service_name": fresh("never"), "service_type": "std_srvs/srv/SetBool", "fields": {"data": True}}
    sent = server.tool("ros2_service_call", **asked, timeout_sec=30)
    time.sleep(0.2)
    server.stop()
    with pytest.raises(Refusal, match="Stopped: "):
        server.result(sent, within_s=2.0)


def test_a_goal_that_is_being_sent(server, observer, chance) -> None:
    """None of those that arrived goes on. In full, none arrives after the answer, either."""
    action = fresh("count")
    observer.act(action=action, think_s=0.2)
    until(lambda: action in str(server.do("ros2_list_actions")))
    for _ in range(ROUNDS):
        observer.forget()
        sent = server.tool("ros2_send_action_goal", action_name=action, goal_fields={"order": 100})
        time.sleep(chance.uniform(0.0, 0.4))
        _, answered_ns = server.stop()
        server.outcome(sent)
        until(lambda: unended(observer, action) == [], ACTION_S)
        goals = observer.goals_of(action=action)
        assert not late([goal["asked"] for goal in goals], answered_ns)
        assert {goal["status"] for goal in goals} <= {"canceled"}


def test_publishes_calls_and_goals_that_are_in_flight_together(server, observer, watched, chance) -> None:
    """10,000 of them in full, 50 in each round: 32 publishes, of which 8 repeat, 14 calls and 4 goals.

    A call shows only when it arrives, so that it is judged in full alone whether it left after the answer.
    """
    action, service = fresh("together"), fresh("serves")
    observer.act(action=action)
    observer.serve(service=service, kind="std_srvs/srv/SetBool")
    until(lambda: action in str(server.do("ros2_list_actions")) and service in str(server.do("ros2_service_list")))
    call = {"service_name": service, "service_type": "std_srvs/srv/SetBool", "fields": {"data": True}}
    ways = ["once"] * 24 + ["repeat"] * 8 + ["call"] * 14 + ["goal"] * 4
    came_late = sent_in_all = 0
    for _ in range(ROUNDS):
        observer.forget()
        chance.shuffle(ways)
        sent = [
            server.tool("ros2_service_call", **call)
            if way == "call"
            else server.tool("ros2_send_action_goal", action_name=action, goal_fields={"order": 100})
            if way == "goal"
            else WAYS[way](server, observer, watched)
            for way in ways
        ]
        time.sleep(chance.uniform(0.0, 0.3))
        _, answered_ns = server.stop()
        for request in sent:
            server.outcome(request)
        has_ended(server, observer, watched, answered_ns)
        asked = [*observer.asked(service=service), *(goal["asked"] for goal in observer.goals_of(action=action))]
        came_late += len(late(asked, answered_ns))
        until(lambda: unended(observer, action) == [], ACTION_S)
        sent_in_all += len(sent)
    print(f"{sent_in_all} commands in flight, {came_late} left after the answer")
    assert came_late == 0


def late(arrived_ns: list[int], answered_ns: int) -> list[int]:
    """In full: what arrived too late after the answer to have left before it."""
    return [at for at in arrived_ns if at > answered_ns + LATEST_S * 1e9] if FULL else []


def unended(observer, action: str) -> list[dict]:
    return [goal for goal in observer.goals_of(action=action) if not goal["ended"]]


@pytest.mark.parametrize("way", ["repeat", "relay", "feed", "playback", "drive"])
def test_what_has_just_begun(server, observer, watched, chance, way: str) -> None:
    for _ in range(ROUNDS):
        sent = WAYS[way](server, observer, watched)
        time.sleep(chance.uniform(0.0, 0.3))
        _, answered_ns = server.stop()
        has_ended(server, observer, watched, answered_ns)
        with suppress(Refusal):
            server.result(sent)
        assert observer.moved(sent_after=answered_ns, topic=watched) == []
        calm(observer, watched)


def test_a_relay_whose_source_comes_only_then(server, observer, watched, chance) -> None:
    given = {"source_topic": f"{watched}_source", "destination_topic": watched, "message_type": TWIST}
    for _ in range(ROUNDS):
        sent = server.tool("ros2_relay_start", **given, duration_sec=0)
        time.sleep(chance.uniform(0.0, 0.3))
        _, answered_ns = server.stop()
        observer.talk(topic=f"{watched}_source", kind=TWIST, hz=50.0, value=MOVING)
        server.outcome(sent)
        has_ended(server, observer, watched, answered_ns)
        calm(observer, watched)


def test_what_waits_for_the_bridge_that_follows_a_killed_one(server, observer, watched, chance) -> None:
    for _ in range(BRIDGES):
        former = server.bridge()
        os.kill(former, signal.SIGKILL)
        sent = []
        for way in ("once", "repeat", "once"):
            time.sleep(chance.uniform(0.0, 0.3))
            sent.append(WAYS[way](server, observer, watched))
        _, answered_ns = server.stop()
        for request in sent:
            server.outcome(request)
        until(lambda bridge=former: server.bridge() != bridge)
        has_ended(server, observer, watched, answered_ns)


def test_what_is_asked_after_the_answer_moves_again(server, observer, watched) -> None:
    for _ in range(3):
        server.stop()
        sent = WAYS["once"](server, observer, watched)
        assert server.result(sent)["status"] == "published"
        observer.until_driven(watched, 1, of=2)  # what is said once may escape the lossy ones
        observer.forget()
    server.stop()
