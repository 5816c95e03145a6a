"""A costmap, or a map in its place: what it costs to be somewhere, and where one can get to from there.

Import it inside functions only: it needs NumPy. `model/costs.py` says what costs mean.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ros2_mcp.model.costs import OCCUPIED, TOUCHING, Narrowest, Reach
from ros2_mcp.world.occupancy import OccupancyGrid

_WIDE_M = 3.0
"""A gap that is wider than this is no narrow spot for anything that drives through doors."""
_MOST_ON_WAY = 400
"""Points of a way that are measured: one each 10 cm of 40 m, and no more work for a longer one."""
_OPPOSITE = -0.5
"""The cosine of 120°: what stands to the other side of the robot, and not round the corner that it drives along."""


class CostGrid(OccupancyGrid):
    """A grid of which the cells say what it costs to be there."""

    def nearest_free(self, x_m: float, y_m: float) -> tuple[float, float] | None:
        """The middle of the nearest cell in which the robot touches nothing; None where there is none."""
        rows, columns = np.nonzero((self.cells >= 0) & (self.cells < TOUCHING))
        if not len(rows):
            return None
        row, column = self.cell(x_m, y_m)
        best = int(np.argmin((rows - row) ** 2 + (columns - column) ** 2))
        return self.point(int(rows[best]), int(columns[best]))

    def nearest_occupied(self, x_m: float, y_m: float) -> tuple[float, float] | None:
        """The middle of the nearest occupied cell; None where there is none."""
        rows, columns = np.nonzero(self.cells >= OCCUPIED)
        if not len(rows):
            return None
        row, column = self.cell(x_m, y_m)
        best = int(np.argmin((rows - row) ** 2 + (columns - column) ** 2))
        return self.point(int(rows[best]), int(columns[best]))

    def reach(self, start: tuple[float, float], goal: tuple[float, float]) -> Reach | None:
        """Where one gets to from `start` through cells in which the robot touches nothing, unknown ones included.

        A robot that touches something begins at the nearest place where it does not. None where the start is outside,
        or in what is occupied.
        """
        cost = self.value(*start)
        if cost is None or cost >= OCCUPIED:
            return None
        free = self.nearest_free(*start) if cost >= TOUCHING else start
        if free is None:
            return None
        row, column = self.cell(*free)
        rows, starts, ends = _runs(self.cells < TOUCHING)
        here = int(np.flatnonzero((rows == row) & (starts <= column) & (column < ends))[0])
        connected = _connected(rows, starts, ends)
        reached = np.flatnonzero(connected == connected[here])
        goal_row, goal_column = self.cell(*goal)
        nearest = np.minimum(np.maximum(starts[reached], goal_column), ends[reached] - 1)
        best = int(np.argmin((rows[reached] - goal_row) ** 2 + (nearest - goal_column) ** 2))
        at = int(rows[reached][best]), int(nearest[best])
        x, y = self.point(*at)
        return Reach(at == (goal_row, goal_column), x, y, math.hypot(goal[0] - x, goal[1] - y))

    def narrowest(self, way: Sequence[tuple[float, float]]) -> Narrowest | None:
        """How near a way leads past what is occupied, and through which gap; None where nothing stands within 3 m."""
        step = max(1, math.ceil(len(way) / _MOST_ON_WAY))
        points: NDArray[np.float64] = np.array([*way[::step], way[-1]])
        taken = self._occupied_around(points)
        if not len(taken):
            return None
        near: tuple[float, int] | None = None
        gap: tuple[float, tuple[float, float]] | None = None
        for index, point in enumerate(points):
            away = taken - point
            far = np.hypot(away[:, 0], away[:, 1])
            first = int(np.argmin(far))
            if far[first] > _WIDE_M:
                continue
            if near is None or far[first] < near[0]:
                near = float(far[first]), index
            others = np.flatnonzero((away @ away[first] <= _OPPOSITE * far * far[first]) & (far <= _WIDE_M))
            if len(others):
                between = taken[others] - taken[first]
                wide = np.hypot(between[:, 0], between[:, 1])
                other = int(np.argmin(wide))
                if wide[other] <= _WIDE_M and (gap is None or wide[other] < gap[0]):
                    x, y = taken[first] + between[other] / 2
                    gap = float(wide[other]), (float(x), float(y))
        if near is None:
            return None
        cell = self.resolution_m  # what is measured is between the middles of cells
        return Narrowest(
            clearance_m=max(near[0] - cell / 2, 0.0),
            clearance_at=(float(points[near[1]][0]), float(points[near[1]][1])),
            gap_m=None if gap is None else max(gap[0] - cell, 0.0),
            gap_at=None if gap is None else gap[1],
        )

    def _occupied_around(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """The middles (n × 2, m) of the occupied cells that are within 3 m of the box around some points."""
        cells = [self.cell(float(x), float(y)) for x, y in points]
        room = math.ceil(_WIDE_M / self.resolution_m)
        low_row, low_column = (max(min(one[axis] for one in cells) - room, 0) for axis in (0, 1))
        high_row, high_column = (max(max(one[axis] for one in cells) + room + 1, 0) for axis in (0, 1))
        rows, columns = np.nonzero(self.cells[low_row:high_row, low_column:high_column] >= OCCUPIED)
        x = (columns + low_column + 0.5) * self.resolution_m
        y = (rows + low_row + 0.5) * self.resolution_m
        cos, sin = math.cos(self.corner.yaw_rad), math.sin(self.corner.yaw_rad)
        return np.stack((self.corner.x_m + cos * x - sin * y, self.corner.y_m + sin * x + cos * y), axis=1)


def _runs(is_open: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """The runs of open cells: their rows, first columns, and columns after the last; row by row."""
    steps = np.diff(np.pad(is_open.astype(np.int8), ((0, 0), (1, 1))), axis=1)
    rows, starts = np.nonzero(steps == 1)
    return rows, starts, np.nonzero(steps == -1)[1]


def _connected(rows: NDArray[np.int64], starts: NDArray[np.int64], ends: NDArray[np.int64]) -> NDArray[np.int64]:
    """For each run a number that it shares with all runs that it touches, at corners too."""
    first = np.searchsorted(rows, np.arange(int(rows[-1]) + 2) if len(rows) else np.zeros(1)).tolist()
    parents, begins, stops = list(range(len(rows))), starts.tolist(), ends.tolist()

    def root(run: int) -> int:
        while parents[run] != run:
            parents[run] = parents[parents[run]]
            run = parents[run]
        return run

    for row in range(1, len(first) - 1):
        above, below = first[row - 1], first[row]
        while above < first[row] and below < first[row + 1]:
            if begins[above] <= stops[below] and begins[below] <= stops[above]:
                parents[root(below)] = root(above)
            if stops[above] < stops[below]:
                above += 1
            else:
                below += 1
    return np.array([root(run) for run in range(len(parents))], np.int64)
