"""Every velocity command that leaves is finite and has the robot's own time; zeros have the frame of the command."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from statistics import median

import pytest

from support.agent import FULL, Refusal, until
from support.driver import COMES_UP_S, Driver, fresh
from support.observer import Observer, observing
from support.standstill import STOOD_STILL_S, undisturbed
from support.velocities import (
    ACKERMANN,
    NOT_FINITE,
    STAMPED,
    TWIST,
    TWIST_STAMPED,
    VELOCITY_TYPES,
    cdr,
    path_of_speed,
    speed,
    with_ackermann,
)

MOST_S, ROUNDED_NS = 0.1, 10
"""DDS has the time at which something was written in steps of 2**-32 s."""
pytestmark = pytest.mark.timeout(1500 if FULL else 300)
FUTURE, ZERO = {"sec": 2_000_000_000, "nanosec": 5}, {"sec": 0, "nanosec": 0}


@pytest.fixture(scope="module")
def environment(ros_environment):
    return with_ackermann(ros_environment)


@pytest.fixture(scope="module")
def observer(environment):
    with observing(environment) as process:
        yield process


@pytest.fixture(scope="module")
def server(environment, observer):
    driver = Driver(environment)
    yield driver
    driver.end()


def ways(server: Driver, topic: str, kind: str, data: dict) -> dict[str, Callable[[], int]]:
    """Every tool that takes a velocity from an agent."""
    one = {"topic_name": topic, "message_type": kind, "data": data}
    timed = {"frequency": 100, "duration": 0.05}
    return {
        "once": lambda: server.tool("ros2_topic_publish", **one),
        "repeat": lambda: server.tool("ros2_topic_publish", **one, **timed),
        "several": lambda: server.tool("ros2_publish_multiple_topics", topics=[{**one, **timed}]),
    }


@pytest.mark.promise("README", "A velocity that is not a finite number is never sent")
@pytest.mark.promise("stopping", "publish refuses it with the path of the field")
@pytest.mark.parametrize("kind", VELOCITY_TYPES)
def test_a_velocity_that_is_not_finite_is_refused_with_its_path_and_never_sent(server, observer, kind: str) -> None:
    topic = fresh("not_finite")
    observer.join(by=topic, topic=topic, kind=kind)
    server.knows(topic, 1)
    for value in NOT_FINITE:
        for way, begin in ways(server, topic, kind, speed(kind, value)).items():
            said = server.outcome(begin())
            assert path_of_speed(kind).split(".", maxsplit=1)[-1] in said, (way, value, said)
            assert any(word in said for word in ("BadValue", "finite", "nvalid")), (way, value, said)
    sound = server.result(ways(server, topic, kind, speed(kind, 0.5))["once"]())
    assert sound["status"] == "published"
    until(lambda: observer.counts(topic=topic)[topic])
    assert observer.unsound(topic=topic) == []
    first, *others = observer.messages(topic=topic)
    # Nothing before it; a stopper may send its zero after it, where a busy machine holds up the bridge.
    assert any(first["values"]) and not any(any(one["values"]) for one in others)
    server.stop()


def test_a_number_that_a_float32_cannot_hold_is_refused(server, observer) -> None:
    topic = fresh("too_large")
    observer.join(by=topic, topic=topic, kind=ACKERMANN)
    server.knows(topic, 1)
    with pytest.raises(Refusal, match="speed"):
        server.result(ways(server, topic, ACKERMANN, speed(ACKERMANN, 1e39))["once"]())
    assert observer.counts(topic=topic)[topic] == 0


def motion_and_zero(server: Driver, observer: Observer, topic: str, kind: str, stamp: dict) -> int:
    """A repeat, one message, and the zero of a stop, all with one frame; returns when they began (wall clock, ns)."""
    observer.forget()
    since_ns = time.time_ns()
    data = speed(kind, 0.5, {"stamp": stamp, "frame_id": "wheels"})
    one = {"topic_name": topic, "message_type": kind, "data": data}

    def has_moved() -> bool:
        """A bridge that is held up leaves out what is late of a repeat: then it is asked for another one."""
        server.do("ros2_topic_publish", **one, frequency=50, duration=0.5)
        server.do("ros2_topic_publish", **one)
        return observer.driven(topic=topic)[topic] >= 10

    until(has_moved, COMES_UP_S)
    stopped_ns = time.time_ns()
    server.stop()
    observer.until_stopped(topic, stopped_ns, full_s=1.0)
    assert {one["frame"] for one in observer.messages(topic=topic)} == {"wheels"}
    return since_ns


@pytest.mark.promise("README", "it stamps commands and zeros with the robot's own time")
@pytest.mark.promise("stopping", "with the frame of the last command and the robot's time as its stamp")
@pytest.mark.parametrize(("kind", "stamp"), zip(STAMPED, (FUTURE, ZERO), strict=True), ids=["future", "zero"])
def test_motions_and_their_zeros_have_the_time_of_now_and_one_frame(server, observer, kind: str, stamp: dict) -> None:
    """Of now: no earlier than when the motion before was written, no later than when they were themselves."""
    topic = fresh("stamped")
    observer.join(by=topic, topic=topic, kind=kind)
    server.knows(topic, 1)
    since_ns = motion_and_zero(server, observer, topic, kind, stamp)
    assert observer.stamped_wrong(topic=topic, since=since_ns) == []


@pytest.mark.full
@pytest.mark.parametrize("kind", STAMPED)
@pytest.mark.parametrize("stamp", [FUTURE, ZERO], ids=["future", "zero"])
def test_motions_and_their_zeros_are_stamped_within_a_tenth_of_a_second(
    server, observer, kind: str, stamp: dict
) -> None:
    topic = fresh("stamped")
    observer.join(by=topic, topic=topic, kind=kind)
    server.knows(topic, 1)

    def off() -> list[str]:
        motion_and_zero(server, observer, topic, kind, stamp)
        return observer.misstamped(most_s=MOST_S, topic=topic)

    assert undisturbed(off) == []


def test_the_zero_of_a_bridge_that_follows_a_killed_one_has_the_frame_and_the_time_of_now(server, observer) -> None:
    topic = fresh("followed")
    observer.join(by=topic, topic=topic, kind=TWIST_STAMPED)
    server.knows(topic, 1)
    data = speed(TWIST_STAMPED, 0.5, {"stamp": FUTURE, "frame_id": "wheels"})
    server.do("ros2_topic_publish", topic_name=topic, message_type=TWIST_STAMPED, data=data)
    observer.until_driven(topic)
    former, since_ns = server.bridge(), time.time_ns()
    os.kill(former, signal.SIGKILL)
    observer.until_stopped(topic, since_ns, full_s=15.0)
    until(lambda: server.bridge() != former)
    last = observer.last(topic=topic)[topic]
    assert last["frame"] == "wheels" and since_ns < last["stamp"] <= last["written"] + ROUNDED_NS
    if FULL:
        assert abs(last["age_s"]) < MOST_S


def test_the_zero_of_a_relay_has_the_frame_of_what_it_passed_on(server, observer) -> None:
    topic, source = fresh("passed"), fresh("source")
    observer.join(by=topic, topic=topic, kind=TWIST_STAMPED)
    observer.offer(topic=source, kind=TWIST_STAMPED)
    given = {"source_topic": source, "destination_topic": topic, "message_type": TWIST_STAMPED}
    since_ns = time.time_ns()
    started = server.do("ros2_relay_start", **given)
    until(lambda: observer.listeners(topic=source))
    until(lambda: observer.matched(by=topic))
    body = cdr(TWIST_STAMPED, 0.5, stamp=(2_000_000_000, 0), frame="left_wheel").hex()

    def heard() -> int:
        observer.say(topic=source, kind=TWIST_STAMPED, bodies=[body])
        return observer.driven(topic=topic)[topic]

    until(heard)
    server.do("ros2_relay_stop", relay_id=started["relay_id"])
    assert observer.comes_to_rest(topic, 1.0 if FULL else 30.0) == []
    assert {one["frame"] for one in observer.messages(topic=topic)} == {"left_wheel"}
    assert observer.stamped_wrong(topic=topic, since=since_ns) == []
    if FULL:
        assert observer.misstamped(most_s=0.5, topic=topic) == []


@pytest.mark.promise("README", "it stamps commands and zeros with the robot's own time")
@pytest.mark.promise("stopping", "the last /clock where a subscriber of the topic uses simulated time")
@pytest.mark.parametrize("factor", [0.1, 5.0])
def test_a_robot_with_simulated_time_gets_its_own(server, observer, factor: float) -> None:
    """The ticks of `/clock` are the judge: each stamp is one that it had told, none is before the one before it, and
    they go on with it.
    """
    topic = simulated(server, observer, factor)
    try:
        told = observer.told()

        def is_of_now() -> bool:
            motion_and_zero(server, observer, topic, TWIST_STAMPED, FUTURE)
            return not observer.untold(topic=topic) and observer.last(topic=topic)[topic]["stamp"] > told

        until(is_of_now, COMES_UP_S)  # until now nobody needed the clock: the bridge has to discover it first
        told = observer.told()
        motion_and_zero(server, observer, topic, TWIST_STAMPED, FUTURE)
        assert observer.untold(topic=topic) == []
        until(is_of_now, COMES_UP_S)
    finally:
        observer.clock(factor=0)


def simulated(server: Driver, observer: Observer, factor: float) -> str:
    """A topic of a robot whose clock runs so many times as fast."""
    observer.clock(factor=factor)
    topic = fresh("simulated")
    observer.join(by=topic, topic=topic, kind=TWIST_STAMPED, sim_time=True, apart=True)
    server.knows(topic, 1)
    until(lambda: observer.listeners(topic="/clock"))
    return topic


@pytest.mark.full
@pytest.mark.parametrize("factor", [0.1, 5.0])
def test_a_robot_with_simulated_time_gets_its_own_within_a_tenth_of_a_second(server, observer, factor: float) -> None:
    """One tick that a busy machine delivers 20 ms late is 0.1 s at 5 x: of the single message it is asked that its tick
    is not older than 0.1 s by the wall clock, of the middle one by the simulated one.
    """
    oldest_s = MOST_S * max(1.0, factor)
    topic = simulated(server, observer, factor)

    def off() -> list[str]:
        motion_and_zero(server, observer, topic, TWIST_STAMPED, FUTURE)
        ages_s = [abs(one["age_s"]) for one in observer.messages(topic=topic)]
        late = [f"half are {median(ages_s):g} s off"] if median(ages_s) > MOST_S else []
        return [*observer.misstamped(most_s=oldest_s, topic=topic), *late]

    try:
        until(lambda: off() == [])  # until now nobody needed the clock: the bridge has to discover it first
        assert undisturbed(off, shortest_s=min(STOOD_STILL_S, oldest_s / factor)) == []
    finally:
        observer.clock(factor=0)


def beside_a_clock(server: Driver, observer: Observer) -> str:
    """A topic of a robot with wall time, where somebody else follows `/clock`."""
    observer.clock(factor=1.0)
    topic, elsewhere = fresh("wall"), fresh("elsewhere")
    observer.join(by=topic, topic=topic, kind=TWIST_STAMPED, apart=True)
    observer.join(by=elsewhere, topic=elsewhere, kind=TWIST, sim_time=True, apart=True)
    server.knows(topic, 1)
    server.knows(elsewhere, 1)
    return topic


@pytest.mark.promise("stopping", "else the wall clock")
def test_a_robot_with_wall_time_is_not_misled_by_a_clock_that_somebody_else_follows(server, observer) -> None:
    topic = beside_a_clock(server, observer)
    try:
        since_ns = motion_and_zero(server, observer, topic, TWIST_STAMPED, ZERO)
        assert observer.stamped_wrong(topic=topic, since=since_ns) == []
    finally:
        observer.clock(factor=0)


@pytest.mark.full
def test_a_robot_with_wall_time_gets_it_within_a_tenth_of_a_second(server, observer) -> None:
    topic = beside_a_clock(server, observer)

    def off() -> list[str]:
        motion_and_zero(server, observer, topic, TWIST_STAMPED, ZERO)
        return observer.misstamped(most_s=MOST_S, topic=topic)

    try:
        assert undisturbed(off) == []
    finally:
        observer.clock(factor=0)
