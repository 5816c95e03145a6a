"""The independent observer as the tests command it."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from support.agent import until
from support.commanded import CommandedProcess
from support.rounds import FULL
from support.velocities import TWIST

DRIVEN_S = 50.0
"""Less than the minute for which tests drive: a new publisher may be discovered late on a busy machine."""
GUARDED_S = 10.0
STOPS_S = 60.0
"""This only ends a hang: how soon a zero comes is measured in full."""


class Observer(CommandedProcess):
    """`observer_peer`; its commands are methods, see there."""

    def __init__(self, environment: dict[str, str], before: Sequence[str] = ()) -> None:
        # Many participants in one process deadlock now and then in Fast DDS when they tell each other directly.
        profiles = {"FASTRTPS_DEFAULT_PROFILES_FILE": str(Path(__file__).with_name("apart_fast_dds.xml"))}
        super().__init__("observer_peer", {**environment, **profiles}, before)

    def watch(self, topic: str, kind: str = TWIST, late_s: tuple[float, ...] = ()) -> list[str]:
        """Four subscribers on a topic, and as many more as come late: three kinds, two of them apart; their names."""
        names = [f"{topic} {what}" for what in ("reliable", "best effort", "apart", "best effort apart")]
        for by, best_effort, apart in zip(names, (0, 1, 0, 1), (0, 0, 1, 1), strict=True):
            self.join(by=by, topic=topic, kind=kind, best_effort=bool(best_effort), apart=bool(apart))
        for number, after_s in enumerate(late_s):
            by = f"{topic} late {number}"
            self.join(by=by, topic=topic, kind=kind, after_s=after_s, best_effort=bool(number % 2), apart=True)
            names.append(by)
        return names

    def until_driven(self, topic: str, number: int = 1, of: int = 1) -> None:
        """Wait until so many subscribers have got at least so many messages that move the robot."""
        until(lambda: sum(count >= number for count in self.driven(topic=topic).values()) >= of, DRIVEN_S)

    def until_guarded(self, topic: str) -> None:
        """Wait until all subscribers know the publishers of a bridge that drives and of both of its stoppers, for which
        it waits 2 s at most: on a busy machine it drives before they are ready. Whether they are judges the test.
        """
        names = [by for by in self.joined() if by.startswith(f"{topic} ")]
        with suppress(AssertionError):
            until(lambda: all(self.matched(by=by) >= 3 for by in names), GUARDED_S)

    def until_stopped(self, topic: str, since_ns: int, full_s: float = STOPS_S) -> None:
        """Wait until each subscriber that was moved has a zero that was written since then (wall clock), and nothing
        that moves it and was written after that zero. `full_s` is how long that may take in full.
        """
        with suppress(AssertionError):
            until(lambda: not self.unstopped(topic=topic, since=since_ns), full_s if FULL else STOPS_S)
        wrong = self.unstopped(topic=topic, since=since_ns)
        assert wrong == [], f"{topic} has not stopped: {wrong}"

    def comes_to_rest(self, topic: str, within_s: float) -> list[str]:
        """The subscribers that a last message still moves when that time is over; returns as soon as there are none."""
        end = time.monotonic() + within_s
        while (left := self.moving(topic=topic)) and time.monotonic() < end:
            time.sleep(0.02)
        return left


@contextmanager
def observing(environment: dict[str, str], before: Sequence[str] = ()) -> Iterator[Observer]:
    """An observer for the time of a block; `before` is what its command begins with."""
    observer = Observer(environment, before)
    try:
        yield observer
    finally:
        observer.kill()
