"""The three courses of a drive, seen from above: a line, a circle, a turn in place. Pure geometry, in m and rad."""

from __future__ import annotations

import math
from typing import NamedTuple


class Pose(NamedTuple):
    """The pose of the base according to odometry; the yaw includes whole turns."""

    x: float
    y: float
    yaw: float


class Place(NamedTuple):
    """The position of the base relative to its course: how far along it (m, or rad of a turn), how far to its left, and
    the difference of its heading (rad).
    """

    along: float
    aside_m: float
    heading: float


def wrapped(angle: float) -> float:
    """Return the same angle within ±π."""
    return math.remainder(angle, 2 * math.pi)


class Line:
    """A straight line ahead from a pose, or backwards: then `whole` is negative (m)."""

    is_turn = False
    curvature = 0.0

    def __init__(self, start: Pose, whole_m: float) -> None:
        self.whole = whole_m
        self._start = start
        self._ahead = math.cos(start.yaw), math.sin(start.yaw)

    def place(self, pose: Pose) -> Place:
        """Return the position of a pose relative to the line."""
        x, y, (cosine, sine) = pose.x - self._start.x, pose.y - self._start.y, self._ahead
        return Place(x * cosine + y * sine, y * cosine - x * sine, pose.yaw - self._start.yaw)


class Circle:
    """An arc ahead on a circle, to the left for a positive angle (rad); `whole` is its length in m."""

    is_turn = False

    def __init__(self, start: Pose, angle: float, radius_m: float) -> None:
        self.whole = abs(angle) * radius_m
        self._start = start
        self._side = math.copysign(1.0, angle)
        self._radius_m = radius_m
        self.curvature = self._side / radius_m
        self._centre = (
            start.x - self._side * radius_m * math.sin(start.yaw),
            start.y + self._side * radius_m * math.cos(start.yaw),
        )
        self._swept = 0.0

    def place(self, pose: Pose) -> Place:
        """Return the position of a pose relative to the circle.

        Call it for each pose in turn, because a circle closes.
        """
        x, y = pose.x - self._centre[0], pose.y - self._centre[1]
        direction = math.atan2(y, x) + self._side * math.pi / 2  # of the circle at this place
        swept = self._side * (direction - self._start.yaw)
        self._swept += wrapped(swept - self._swept)
        aside_m = self._side * (self._radius_m - math.hypot(x, y))
        return Place(self._swept * self._radius_m, aside_m, pose.yaw - (self._start.yaw + self._side * self._swept))


class Turn:
    """A turn in place, to the left for a positive angle; `whole` is the angle in rad."""

    is_turn = True
    curvature = 0.0

    def __init__(self, start: Pose, angle: float) -> None:
        self.whole = angle
        self._start = start

    def place(self, pose: Pose) -> Place:
        """Return the position of a pose relative to the turn; `aside_m` is the distance from where the turn began."""
        away_m = math.hypot(pose.x - self._start.x, pose.y - self._start.y)
        return Place(pose.yaw - self._start.yaw, away_m, 0.0)
