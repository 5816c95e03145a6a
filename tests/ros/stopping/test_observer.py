"""The observer sees what a node of rclpy publishes: it would see a fault."""

from __future__ import annotations

import math
import struct
import time

from support.agent import FULL, until
from support.velocities import TWIST, TWIST_STAMPED

CDR = b"\0\1\0\0"
ROUNDED_NS = 10
"""DDS has the time at which something was written in steps of 2**-32 s."""


def test_it_tells_for_each_subscriber_what_came_and_when(observer) -> None:
    names = observer.watch("/seen", TWIST)
    observer.talk(topic="/seen", kind=TWIST, hz=50, value=0.5)
    observer.until_driven("/seen", 3, of=4)
    observer.join(by="late", topic="/seen", kind=TWIST, after_s=0.2, apart=True)
    observer.until_driven("/seen", 3, of=5)
    observer.hush(topic="/seen")
    before_ns = time.time_ns()
    assert any("no zero" in line for line in observer.unstopped(topic="/seen", since=before_ns))

    def have_zeros() -> bool:
        """Said again to those who acknowledge nothing, of whom one may have missed it."""
        observer.say(topic="/seen", kind=TWIST, bodies=[(CDR + bytes(48)).hex()])
        return observer.unstopped(topic="/seen", since=before_ns) == []

    until(have_zeros, 5.0 if FULL else 60.0)
    after_ns = time.time_ns()
    assert set(observer.last(topic="/seen")) == {*names, "late"}
    last = observer.last(topic="/seen")["late"]
    assert last["values"] == [0.0] * 6 and last["sent"] <= last["at"]
    if FULL:
        assert last["at"] - last["sent"] < 1e9
    assert before_ns - ROUNDED_NS <= last["written"] <= after_ns
    observer.leave(by="late")
    assert observer.moved(topic="/seen", sent_after=last["sent"]) == []
    after_its_zero = tuple(f"{name}: after its zero" for name in names)

    def told() -> list[str]:
        observer.say(topic="/seen", kind=TWIST, bodies=[(CDR + struct.pack("<6d", 0.5, 0, 0, 0, 0, 0)).hex()])
        return observer.unstopped(topic="/seen", since=before_ns)

    def is_told_of_all() -> bool:
        lines = told()
        assert all(line.startswith(after_its_zero) for line in lines), lines
        return all(any(line.startswith(said) for line in lines) for said in after_its_zero)

    until(is_told_of_all)


def test_it_tells_what_is_not_finite_or_cannot_be_decoded(observer) -> None:
    observer.join(by="any", topic="/odd", kind=TWIST)
    bad = [CDR + struct.pack("<6d", 0, 0, math.nan, 0, 0, 0), CDR + b"\1\2\3"]
    observer.offer(topic="/odd", kind=TWIST)
    until(lambda: observer.listeners(topic="/odd"))
    observer.say(topic="/odd", kind=TWIST, bodies=[one.hex() for one in bad])
    assert len(until(lambda: observer.unsound(topic="/odd"))) >= 1


def test_it_compares_stamps_with_the_clock_of_the_subscriber(observer) -> None:
    observer.clock(factor=5.0)
    observer.join(by="simulated", topic="/stamped", kind=TWIST_STAMPED, sim_time=True, apart=True)
    observer.offer(topic="/stamped", kind=TWIST_STAMPED)
    until(lambda: observer.listeners(topic="/stamped"))

    def age_s() -> float:
        observer.say(
            topic="/stamped", kind=TWIST_STAMPED, bodies=[(CDR + struct.pack("<iI", 1000, 0) + bytes(60)).hex()]
        )
        last = until(lambda: observer.last(topic="/stamped"))["simulated"]
        return last["age_s"]

    until(lambda: age_s() > 1.0)  # until then it has not heard the clock, and is at 0
    assert observer.misstamped(most_s=1.0, topic="/stamped")
    assert observer.untold(topic="/stamped"), "a stamp that /clock has not told"
    assert observer.stamped_wrong(topic="/stamped", since=time.time_ns()), (
        "a stamp of another time than that of writing"
    )
    observer.clock(factor=0)
