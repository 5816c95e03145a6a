"""A costmap, or a map used as a costmap: the cost at a point, and which points can be reached.

Import it inside functions only: it needs NumPy. `model/costs.py` defines the costs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ros2_mcp.model.costs import OCCUPIED, TOUCHING, Narrowest, Reach
from ros2_mcp.world.occupancy import OccupancyGrid

_WIDE_M = 3.0
"""A gap wider than this is no narrow spot for any robot that drives through doors."""
_MOST_ON_WAY = 400
"""Points at which a path is measured: one per 10 cm of a 40 m path; longer paths are sampled more coarsely."""
_OPPOSITE = -0.5
"""The cosine of 120°: an obstacle at a larger angle is on the other side of the robot, not around the corner ahead."""


class CostGrid(OccupancyGrid):
    """A grid whose cells are costs."""

    def nearest_free(self, x_m: float, y_m: float) -> tuple[float, float] | None:
        """Return the centre of the nearest cell whose cost is below `TOUCHING`, in m; None if there is none."""
        rows, columns = np.nonzero((self.cells >= 0) & (self.cells < TOUCHING))
        if not len(rows):
            return None
        row, column = self.cell(x_m, y_m)
        best = int(np.argmin((rows - row) ** 2 + (columns - column) ** 2))
        return self.point(int(rows[best]), int(columns[best]))

    def nearest_occupied(self, x_m: float, y_m: float) -> tuple[float, float] | None:
        """Return the centre of the nearest occupied cell, in m; None if there is none."""
        rows, columns = np.nonzero(self.cells >= OCCUPIED)
        if not len(rows):
            return None
        row, column = self.cell(x_m, y_m)
        best = int(np.argmin((rows - row) ** 2 + (columns - column) ** 2))
        return self.point(int(rows[best]), int(columns[best]))

    def reach(self, start: tuple[float, float], goal: tuple[float, float]) -> Reach | None:
        """Return the point nearest to `goal` that is reachable from `start` without touching an obstacle.

        Unknown cells count as free. If the robot touches an obstacle at `start`, the search begins at the nearest free
        cell. None if `start` is outside of the grid or in an occupied cell.
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
        """Return the least clearance along a path and its narrowest gap; None if no obstacle is within 3 m of it."""
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
        cell = self.resolution_m  # distances were measured between the centres of cells
        return Narrowest(
            clearance_m=max(near[0] - cell / 2, 0.0),
            clearance_at=(float(points[near[1]][0]), float(points[near[1]][1])),
            gap_m=None if gap is None else max(gap[0] - cell, 0.0),
            gap_at=None if gap is None else gap[1],
        )

    def _occupied_around(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the centres (n × 2, in m) of the occupied cells within 3 m of the bounding box of some points."""
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
    """Return the runs of open cells, row by row: their rows, first columns, and last columns plus 1."""
    steps = np.diff(np.pad(is_open.astype(np.int8), ((0, 0), (1, 1))), axis=1)
    rows, starts = np.nonzero(steps == 1)
    return rows, starts, np.nonzero(steps == -1)[1]


def _connected(rows: NDArray[np.int64], starts: NDArray[np.int64], ends: NDArray[np.int64]) -> NDArray[np.int64]:
    """Label the runs: runs that are connected, also at corners, share a number."""
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
