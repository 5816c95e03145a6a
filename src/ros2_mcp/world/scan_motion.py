"""How far a robot moved and turned between two laser scans, by the scans alone: no odometry, no map."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

_REACH_M = 6.0
"""Points farther away than this are not used: their distance to each other is large, and they fit by chance."""
_LEAST_M = 0.3
"""Nearer points may be parts of the robot, which move with it."""
_MOST_POINTS = 180
_LEAST_POINTS = 40
_COARSE_CELL_M, _COARSE_WIDTH_M = 0.05, 0.1
_FINE_CELL_M, _FINE_WIDTH_M = 0.02, 0.04
"""Cells, and how fast the fit falls with the distance: at first as wide as the steps of the search, then as the noise
of a scanner."""
_MARGIN = 12
"""Cells at the edge that no point is in: those of its neighbourhood are."""
_STEP_M, _STEP_RAD = 0.1, math.radians(3)
_FITS, _LEAST_SHARE = 0.5, 0.5
_OTHER_M, _OTHER_RAD, _ALIKE = 0.2, math.radians(10), 0.93
"""If a motion that differs by this much fits nearly as well, as along a corridor or in a round room, none is known."""


@dataclass(frozen=True, slots=True)
class ScanMotion:
    """The motion of the frame in which both scans are, in the first pose: m ahead, m to the left, rad to the left."""

    x_m: float
    y_m: float
    yaw_rad: float


def motion_between(
    before: NDArray[np.float64], after: NDArray[np.float64], most_m: float, most_rad: float
) -> ScanMotion | None:
    """Return the motion by which the points of two scans (n × 2, in the robot's frame, m) fit each other; None if too
    few do, or if several motions fit.

    Only motions of at most `most_m` along x and y, and of `most_rad`, are looked at.
    """
    before, after = _usable(before), _usable(after)
    if min(len(before), len(after)) < _LEAST_POINTS:
        return None
    few = after[:: max(1, math.ceil(len(after) / _MOST_POINTS))]
    wide, narrow = _Field(before, _COARSE_CELL_M, _COARSE_WIDTH_M), _Field(before, _FINE_CELL_M, _FINE_WIDTH_M)
    tried = _steps((0.0, 0.0, 0.0), (most_m, _STEP_M), (most_rad, _STEP_RAD))
    scores = np.array([wide.fit(few, one).mean() for one in tried])
    best = tried[int(scores.argmax())]
    others = [math.hypot(x - best[0], y - best[1]) > _OTHER_M or abs(yaw - best[2]) > _OTHER_RAD for x, y, yaw in tried]
    if scores[others].max(initial=0.0) > _ALIKE * scores.max():
        return None
    for field, metres, angles in (
        (wide, (0.1, 0.04), (_STEP_RAD, math.radians(1))),
        (narrow, (0.04, 0.02), (math.radians(1.5), math.radians(0.5))),
        (narrow, (0.01, 0.01), (math.radians(0.25), math.radians(0.25))),
    ):
        tried = _steps(best, metres, angles)
        best = max(tried, key=lambda one, field=field: float(field.fit(after, one).mean()))
    if float((narrow.fit(after, best) > _FITS).mean()) < _LEAST_SHARE:
        return None
    return ScanMotion(*best)


class _Field:
    """How near each place is to a point: 1 at a point, less with the distance."""

    def __init__(self, points: NDArray[np.float64], cell_m: float, width_m: float) -> None:
        self._cell_m = cell_m
        size = 2 * math.ceil((_REACH_M + 1.0) / cell_m) + 1
        self._cells: Any = np.zeros((size, size))
        reach = math.ceil(2 * width_m / cell_m)
        places = self._places(points)
        for row, column in itertools.product(range(-reach, reach + 1), repeat=2):
            near = math.exp(-0.5 * (math.hypot(row, column) * cell_m / width_m) ** 2)
            np.maximum.at(self._cells, (places[:, 0] + row, places[:, 1] + column), near)

    def fit(self, points: NDArray[np.float64], motion: tuple[float, float, float]) -> Any:
        """Return how well each point fits after a motion, 0 to 1."""
        x, y, yaw = motion
        cos, sin = math.cos(yaw), math.sin(yaw)
        moved = points @ np.array([[cos, sin], [-sin, cos]]) + (x, y)
        places = self._places(moved)
        return self._cells[places[:, 0], places[:, 1]]

    def _places(self, points: NDArray[np.float64]) -> NDArray[np.int64]:
        size = len(self._cells)
        places = np.rint(points / self._cell_m).astype(np.int64) + size // 2
        return np.minimum(np.maximum(places, _MARGIN), size - 1 - _MARGIN)


def _usable(points: NDArray[np.float64]) -> NDArray[np.float64]:
    away = np.hypot(points[:, 0], points[:, 1])
    return points[(away > _LEAST_M) & (away < _REACH_M)]


def _steps(
    middle: tuple[float, float, float], metres: tuple[float, float], angles: tuple[float, float]
) -> list[tuple[float, float, float]]:
    """Return the motions around a motion: up to so many metres and rad away, in such steps."""
    most_m, step_m = metres
    most_rad, step_rad = angles
    along = [step_m * number for number in range(-round(most_m / step_m), round(most_m / step_m) + 1)]
    turns = [step_rad * number for number in range(-round(most_rad / step_rad), round(most_rad / step_rad) + 1)]
    x, y, yaw = middle
    return [(x + dx, y + dy, yaw + turn) for dx, dy, turn in itertools.product(along, along, turns)]
