"""Nudges: short commands of a reckoned length, for what is left when a robot cannot move as slowly as it should.

A robot with friction does not turn its wheels below some speed, and what odometry tells of that speed comes too late to
stop it in time. But how far one short command carries it does not depend on that delay: so it is given, its way is
measured when the robot stands, and the next one is as much longer or shorter as it has to be. No ROS; m or rad, and s.
"""

from __future__ import annotations

from typing import NamedTuple

# The shortest and the longest, s: two looks of the runner, and what is still short beside a drive.
LEAST_S, MOST_S = 0.02, 0.6
# The way of a nudge grows with its time, or with the square of that while the robot still speeds up: in between.
POWER = 0.7
# One that moved nothing is followed by one that is so much faster and longer; none is changed by more than the second
# factor at once. Chosen.
FASTER, MOST_CHANGED = 1.4, 3.0


class Nudge(NamedTuple):
    """One: how fast, with its direction (m/s or rad/s), and for how long."""

    speed: float
    length_s: float


class Nudges:
    """What was learnt of those of one drive, all of the same kind (along, or on the spot)."""

    def __init__(self, least_moved: float) -> None:
        self._least_moved = least_moved
        self._speed = 0.0
        self._length_s = 0.0
        self._moved = 0.0

    def next(self, left: float, slowest: float, fastest: float) -> Nudge:
        """The one that should carry it over what is `left`. `slowest` is the least command that may move it."""
        if not self._length_s:
            self._speed = slowest
            wanted_s = abs(left) / slowest
        elif self._moved < self._least_moved:
            self._speed *= FASTER
            wanted_s = max(self._length_s, abs(left) / self._speed) * FASTER
        else:
            change = (abs(left) / self._moved) ** POWER
            wanted_s = self._length_s * min(MOST_CHANGED, max(1 / MOST_CHANGED, change))
        self._speed = min(self._speed, fastest)
        return Nudge(self._speed if left > 0 else -self._speed, min(MOST_S, max(LEAST_S, wanted_s)))

    def learn(self, length_s: float, moved: float) -> None:
        """How long the last one really was, and how far it carried the robot in its direction."""
        self._length_s, self._moved = length_s, moved
