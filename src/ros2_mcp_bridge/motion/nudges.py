"""Nudges: short commands of a computed length, for the rest of a course when a robot cannot move as slowly as needed.

A robot with friction does not turn its wheels below some speed, and the odometry of that motion comes too late to stop
it in time. But how far one short command carries it does not depend on that delay. So a command is given, the distance
is measured when the robot is at rest, and the next command is longer or shorter accordingly. No ROS; m or rad, and s.
"""

from __future__ import annotations

from typing import NamedTuple

# The shortest and the longest nudge, in s: two looks of the runner, and a time that is still short compared with a
# drive.
LEAST_S, MOST_S = 0.02, 0.6
# The exponent of the change in length. The distance grows with the length, or with its square while the robot still
# accelerates: this is in between.
POWER = 0.7
# After a nudge that moved nothing, the next is faster and longer by the first factor. No change exceeds the second
# factor.
FASTER, MOST_CHANGED = 1.4, 3.0


class Nudge(NamedTuple):
    """One nudge: its speed, with the sign of its direction (m/s or rad/s), and its length in s."""

    speed: float
    length_s: float


class Nudges:
    """Chooses the nudges of one drive by the effect of the earlier ones, which are all of the same kind (along the
    course, or in place).
    """

    def __init__(self, least_moved: float) -> None:
        self._least_moved = least_moved
        self._speed = 0.0
        self._length_s = 0.0
        self._moved = 0.0

    def next(self, left: float, slowest: float, fastest: float) -> Nudge:
        """Return the nudge that should carry the robot by `left` (m or rad).

        `slowest` is the least speed that may move it.
        """
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
        """Record how long the last nudge really was (s), and how far it carried the robot in its direction."""
        self._length_s, self._moved = length_s, moved
