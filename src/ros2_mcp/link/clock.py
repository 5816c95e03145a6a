"""The offset of the robot's clock from this machine's clock, and the round-trip time to the robot."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

# The time for which a round trip is used. Clocks of two machines drift apart by some 50 millionths, 3 ms in this time.
# A longer time would add more error than a shorter, earlier round trip removes; and a longer route is noticed only
# after this time.
_REMEMBERED_S = 60.0


@dataclass(frozen=True, slots=True)
class _RoundTrip:
    """One ping and its reply: sent and received by this machine's clock, answered by the robot's, in ns of Unix
    time.
    """

    sent_ns: int
    robot_ns: int
    received_ns: int
    at_s: float

    @property
    def rtt_ns(self) -> int:
        return self.received_ns - self.sent_ns

    @property
    def least_ns(self) -> int:
        """The least offset: the robot answered before the reply was received."""
        return self.robot_ns - self.received_ns

    @property
    def most_ns(self) -> int:
        """The greatest offset: the robot answered after the ping was sent."""
        return self.robot_ns - self.sent_ns


class RobotClock:
    """The robot's clock, estimated from its replies to pings; equal to this machine's clock until the first reply.

    The shortest round trip of the last minute is used: the error is at most half of its duration. A round trip that
    contradicts the former estimate means that a clock was set or a machine slept: all earlier ones are discarded.
    """

    def __init__(
        self, now_ns: Callable[[], int] = time.time_ns, monotonic: Callable[[], float] = time.monotonic
    ) -> None:
        self._now_ns = now_ns
        self._monotonic = monotonic
        self._round_trips: deque[_RoundTrip] = deque()
        self._best: _RoundTrip | None = None

    def sending_ns(self) -> int:
        """Return the present time of this machine, in ns, to be sent with a ping and returned by its reply."""
        return self._now_ns()

    def answered(self, sent_ns: int, robot_ns: int) -> None:
        """Add a reply that has just arrived, with the robot's time."""
        trip = _RoundTrip(sent_ns, robot_ns, self._now_ns(), self._monotonic())
        if trip.rtt_ns < 0:  # this machine's clock was set back meanwhile
            self._round_trips.clear()
            self._best = None
            return
        best = self._best
        if best and (trip.least_ns > best.most_ns or trip.most_ns < best.least_ns):
            self._round_trips.clear()
        while self._round_trips and self._round_trips[0].at_s < trip.at_s - _REMEMBERED_S:
            self._round_trips.popleft()
        # A round trip that took longer than a later one can no longer become the best.
        while self._round_trips and self._round_trips[-1].rtt_ns >= trip.rtt_ns:
            self._round_trips.pop()
        self._round_trips.append(trip)
        self._best = self._round_trips[0]

    @property
    def is_known(self) -> bool:
        """Whether the robot's time is known."""
        return self._best is not None

    @property
    def offset_ns(self) -> int:
        """The lead of the robot's clock over this machine's, in ns; 0 if the two cannot be told apart, as on one
        machine.
        """
        best = self._best
        if best is None or best.least_ns <= 0 <= best.most_ns:
            return 0
        return (best.least_ns + best.most_ns) // 2

    @property
    def rtt_s(self) -> float | None:
        """The shortest round-trip time of the last minute, in s; None before the first reply."""
        return self._best.rtt_ns / 1e9 if self._best else None

    def now_ns(self) -> int:
        """Return the present time of the robot's clock, in ns of Unix time."""
        return self._now_ns() + self.offset_ns
