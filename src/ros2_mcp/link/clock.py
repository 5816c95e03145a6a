"""How far the robot's clock is from this machine's, and how long the way to the robot and back takes."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

# Clocks of two machines drift apart by some 50 millionths: by 3 ms in this time. Longer would add more error than a
# shorter way, found earlier, takes away; and a way that has become longer is told as late as that.
_REMEMBERED_S = 60.0


@dataclass(frozen=True, slots=True)
class _RoundTrip:
    """One question and its answer: sent and received by our clock, answered by the robot's, in ns of Unix time."""

    sent_ns: int
    robot_ns: int
    received_ns: int
    at_s: float

    @property
    def rtt_ns(self) -> int:
        return self.received_ns - self.sent_ns

    @property
    def least_ns(self) -> int:
        """The robot answered before we received it: its clock is ahead by no less than this."""
        return self.robot_ns - self.received_ns

    @property
    def most_ns(self) -> int:
        """It answered after we asked: its clock is ahead by no more than this."""
        return self.robot_ns - self.sent_ns


class RobotClock:
    """The robot's clock, as its answers to pings tell of it; until the first one it is taken for ours.

    Of the round trips of the last minute the one with the shortest way there and back decides: its middle is off by
    half of that way at most. One that contradicts an earlier one means that a clock was set, or that a machine slept:
    all before it is forgotten.
    """

    def __init__(
        self, now_ns: Callable[[], int] = time.time_ns, monotonic: Callable[[], float] = time.monotonic
    ) -> None:
        self._now_ns = now_ns
        self._monotonic = monotonic
        self._round_trips: deque[_RoundTrip] = deque()
        self._best: _RoundTrip | None = None

    def sending_ns(self) -> int:
        """Our time, to be sent with a question and back with its answer."""
        return self._now_ns()

    def answered(self, sent_ns: int, robot_ns: int) -> None:
        """Takes in an answer that has just come, with the robot's time."""
        trip = _RoundTrip(sent_ns, robot_ns, self._now_ns(), self._monotonic())
        if trip.rtt_ns < 0:  # our own clock was set back meanwhile
            self._round_trips.clear()
            self._best = None
            return
        best = self._best
        if best and (trip.least_ns > best.most_ns or trip.most_ns < best.least_ns):
            self._round_trips.clear()
        while self._round_trips and self._round_trips[0].at_s < trip.at_s - _REMEMBERED_S:
            self._round_trips.popleft()
        # Of those that took longer than a later one, none can become the best any more.
        while self._round_trips and self._round_trips[-1].rtt_ns >= trip.rtt_ns:
            self._round_trips.pop()
        self._round_trips.append(trip)
        self._best = self._round_trips[0]

    @property
    def is_known(self) -> bool:
        """Whether the robot has told its time."""
        return self._best is not None

    @property
    def offset_ns(self) -> int:
        """How far the robot's clock is ahead of ours; 0 where it cannot be told from ours, as on one machine."""
        best = self._best
        if best is None or best.least_ns <= 0 <= best.most_ns:
            return 0
        return (best.least_ns + best.most_ns) // 2

    @property
    def rtt_s(self) -> float | None:
        """The shortest way to the robot and back of the last minute; None before the first answer."""
        return self._best.rtt_ns / 1e9 if self._best else None

    def now_ns(self) -> int:
        """The time of the robot's clock now, in ns of Unix time."""
        return self._now_ns() + self.offset_ns
