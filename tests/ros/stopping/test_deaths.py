"""Whatever dies while it drives: every subscriber that was ever moved gets a zero, and then nothing that moves it.

One death of a bridge that drives in every way, 200 of one way each in full.
"""

from __future__ import annotations

import os
import random
import signal
import time
from contextlib import suppress

import pytest

from support.agent import FULL, Refusal, until
from support.driver import BAG, COMES_UP_S, LONG_S, MOVING, WAYS, calm, fresh, going_on, until_driven
from support.observer import STOPS_S
from support.velocities import TWIST, speed

DEATHS = 200
SUCCESSOR_S = 15.0
"""A new bridge needs two seconds, and looks for subscribers for ten more. Judged in full, as is the next."""
GONE_S = 2.0
"""A bridge whose server died sends its zeros in a fraction of this."""

pytestmark = pytest.mark.timeout(1800 if FULL else 300)


def drive(server, observer, way: str, late_s: tuple[float, ...] = ()) -> tuple[str, int]:
    """A topic that is driven: its name, and the request that drives it."""
    topic = fresh(f"driven_{way}")
    observer.watch(topic, late_s=late_s)
    server.knows(topic, 4)
    request = WAYS[way](server, observer, topic)
    # What is said once may escape the lossy ones.
    return topic, until_driven(server, observer, way, topic, request, of=2 if way == "once" else 4)


def end(server, observer, topic: str, request: int, since_ns: int = 0) -> None:
    """Let go of all that is left of a round; nothing has moved the robot after the zero that came after that time."""
    calm(observer, topic)
    with suppress(Refusal):
        server.result(request)
    assert not since_ns or observer.unstopped(topic=topic, since=since_ns) == []
    for by in observer.counts(topic=topic):
        if by.startswith(f"{topic} "):
            observer.leave(by=by)


@pytest.mark.promise("README", "and when the bridge dies")
@pytest.mark.promise("stopping", "its successor sends the zeros, to each subscriber as it discovers it")
def test_a_bridge_that_is_killed_leaves_nobody_without_a_zero_however_it_drove(server, observer) -> None:
    """Four subscribers of each topic, and two of the last that join meanwhile, whom its successor discovers last."""
    driven = {way: drive(server, observer, way) for way in sorted({*WAYS} - {"once"})}
    driven["once"] = drive(server, observer, "once", late_s=(0.1, 0.5))
    topic, request = driven["drive"]
    driven["drive"] = topic, going_on(server, observer, topic, request)
    bridge, since_ns = server.bridge(), time.time_ns()
    os.kill(bridge, signal.SIGKILL)
    for topic, _ in driven.values():
        observer.until_stopped(topic, since_ns)
    until(lambda: server.bridge() != bridge)
    server.stop()
    for topic, request in driven.values():
        end(server, observer, topic, request, since_ns)


@pytest.mark.full
def test_of_two_hundred_bridges_that_are_killed_none_leaves_anybody_without_a_zero(server, observer) -> None:
    """Four subscribers, and two that have joined shortly before, whom its successor discovers last."""
    ways = sorted(WAYS, key="once".__eq__)  # last, so in full only: the test after the next has one of it
    chance, unstopped = random.Random(10), []
    for number in range(DEATHS):
        bridge, way = server.bridge(), ways[number % len(ways)]
        topic, request = drive(server, observer, way, late_s=(chance.uniform(0.1, 1.0), chance.uniform(0.1, 1.0)))
        time.sleep(chance.uniform(0.0, 1.0))
        os.kill(bridge, signal.SIGKILL)
        killed_ns = time.monotonic_ns()
        until(lambda former=bridge: server.bridge() != former)
        calm(observer, topic)
        left = observer.comes_to_rest(topic, SUCCESSOR_S)
        if left:
            unstopped.append((number, way, left))
        took_s = (max(one["at"] for one in observer.last(topic=topic).values()) - killed_ns) / 1e9
        print(f"death {number}, {way}: {took_s:.2f} s, without a zero: {left}", flush=True)
        server.stop()
        end(server, observer, topic, request)
        observer.forget()
    assert unstopped == [], f"{len(unstopped)} of {DEATHS} deaths"


@pytest.mark.promise("stopping", "after 4 s the server gives such a bridge up, and its successor sends the zero")
def test_a_bridge_that_is_blocked_is_given_up_and_its_successor_sends_the_zero(server, observer) -> None:
    """Nothing of it runs any more, as where its middleware blocks it."""
    topic, request = drive(server, observer, "repeat")
    blocked, since_ns = server.bridge(), time.time_ns()
    os.kill(blocked, signal.SIGSTOP)
    until(lambda: server.bridge() not in (None, blocked), SUCCESSOR_S if FULL else COMES_UP_S)
    observer.until_stopped(topic, since_ns, full_s=SUCCESSOR_S)
    server.stop()
    end(server, observer, topic, request, since_ns)


def test_a_driver_that_joined_later_and_asks_for_more_gets_a_zero_when_the_bridge_dies(server, observer) -> None:
    """The topic is driven with two kinds of publishers: the first one never matches who is reliable."""
    topic = fresh("joined")
    message = {"topic_name": topic, "message_type": TWIST, "data": speed(TWIST, MOVING)}
    observer.join(by=f"{topic} lossy", topic=topic, kind=TWIST, best_effort=True)
    server.knows(topic, 1)
    server.do("ros2_topic_publish", **message)
    observer.join(by=f"{topic} reliable", topic=topic, kind=TWIST, apart=True)
    server.knows(topic, 2)
    server.do("ros2_topic_publish", **message)
    until(lambda: observer.driven(topic=topic)[f"{topic} reliable"])
    kill_bridge(server, observer, topic)


def kill_bridge(server, observer, topic: str, how: int = signal.SIGKILL) -> None:
    """The bridge dies, every subscriber has a zero, and has its successor's answer as the end of all that was sent."""
    former, since_ns = server.bridge(), time.time_ns()
    os.kill(former, how)
    observer.until_stopped(topic, since_ns, full_s=SUCCESSOR_S)
    until(lambda: server.bridge() != former)
    assert observer.unstopped(topic=topic, since=since_ns) == []


def played(server, observer) -> str:
    """A topic onto which a bag was played to its end: the robot goes on with its last command."""
    topic = fresh("played")
    observer.watch(topic)
    server.knows(topic, 4)

    def has_driven_all() -> bool:
        """A bag of 0.2 s may be over before those who acknowledge nothing know its publisher: it is played again."""
        ended = server.do("ros2_bag_play", bag=BAG, remaps={"/cmd_vel": topic}, force=True, rate=10)
        assert ended["state"] == "ended"
        return sum(count >= 1 for count in observer.driven(topic=topic).values()) >= 4

    until(has_driven_all, 60.0)
    return topic


def test_a_bag_played_onto_a_velocity_topic_is_followed_by_zero_when_its_bridge_dies(server, observer) -> None:
    """ros2_stop then names the topic that the bag moved beneath the bridge that died, too."""
    topic = played(server, observer)
    kill_bridge(server, observer, topic)
    stopped, _ = server.stop()
    assert topic in [one["topic_name"] for one in stopped["topics"]]
    assert observer.moving(topic=topic) == []


@pytest.mark.promise("README", "a repeat, relay or playback when it ends, whatever ends it")
@pytest.mark.parametrize("how", ["SIGTERM", "SIGKILL"])
def test_a_bag_played_onto_a_velocity_topic_is_followed_by_zero_when_its_server_ends(
    start_server, observer, how: str
) -> None:
    server = start_server()
    topic = played(server, observer)
    since_ns = time.time_ns()
    server.process.send_signal(getattr(signal, how))
    observer.until_stopped(topic, since_ns, full_s=GONE_S)


def test_a_bridge_that_is_asked_to_end_while_a_bag_drives_leaves_a_zero(server, observer) -> None:
    topic, _ = drive(server, observer, "playback")
    kill_bridge(server, observer, topic, signal.SIGTERM)


def test_ros2_stop_after_a_bag_drove_says_what_it_stopped(server, observer) -> None:
    topic = played(server, observer)
    stopped, _ = server.stop()
    [row] = [one for one in stopped["topics"] if one["topic_name"] == topic]
    # Two of the four subscribers are best effort, and acknowledge nothing: that all were reached cannot be confirmed.
    assert (stopped["confirmed"], row["acknowledged"]) == (False, None)
    assert (row["subscribers"], row["unreached_subscribers"]) == (4, 0)
    assert observer.comes_to_rest(topic, STOPS_S) == []  # those who acknowledge nothing may get it after the answer


@pytest.mark.promise("README", "At most 64 velocity topics are driven at a time, each with its fail-safe")
@pytest.mark.promise("README", "one more is refused")
@pytest.mark.promise("stopping", "A 65th velocity topic, because only 64 have a fail-safe")
def test_the_sixty_fifth_topic_is_refused_and_the_first_keeps_its_zero(start_server, observer) -> None:
    server = start_server()
    topics = [fresh("many") for _ in range(66)]
    for topic in topics:
        observer.join(by=topic, topic=topic, kind=TWIST)
    server.knows(topics[-1], 1)
    moves = {"topic_name": topics[0], "message_type": TWIST, "data": speed(TWIST, MOVING)}
    # On a busy machine those after it may take longer than the minute of other repeats.
    first = server.tool("ros2_topic_publish", **moves, frequency=50, duration=10 * LONG_S)
    observer.until_driven(topics[0])
    outcomes: dict[str, str] = {}
    for topic in topics[1:]:
        sent = server.tool("ros2_topic_publish", topic_name=topic, message_type=TWIST, data=speed(TWIST, MOVING))
        try:
            outcomes[topic] = server.result(sent)["status"]
        except Refusal as refusal:
            outcomes[topic] = str(refusal)
    assert {outcomes[topic] for topic in topics[1:64]} == {"published"}
    for topic in topics[64:]:
        assert outcomes[topic].startswith("Refused") and "64" in outcomes[topic]
    assert not any(observer.driven(topic=topic)[topic] for topic in topics[64:])
    since_ns = time.time_ns()
    server.process.kill()
    for topic in topics[:64]:
        observer.until_stopped(topic, since_ns, full_s=GONE_S)
    assert first not in server.answers
