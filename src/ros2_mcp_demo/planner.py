"""Plans a path on an occupancy grid (A*) and follows it (pure pursuit). No ROS."""

# pyright: basic
from __future__ import annotations

import heapq
import math
from dataclasses import dataclass

import numpy as np

from .base import Pose, wrapped

RESOLUTION = 0.1  # m
INFLATION = 0.33  # m, as far from the middle of the robot; its radius is 0.2
LOOKAHEAD = 0.25
SPACING = 0.05
TURN_FIRST = math.radians(50)

_NEIGHBOURS = [(dx, dy, math.hypot(dx, dy)) for dx in (-1, 0, 1) for dy in (-1, 0, 1) if dx or dy]


@dataclass
class Costmap:
    """The cells where the robot's centre may be: `blocked` is bool (rows, columns), row 0 at the smallest y.

    `occupied`, of the same shape, marks occupied cells; None if unknown.
    """

    blocked: np.ndarray
    origin: tuple[float, float]
    occupied: np.ndarray | None = None

    @classmethod
    def from_occupancy(cls, cells, origin, resolution, points=()):
        """Coarsen a map (int8; unknown counts as occupied), add seen points (n, 2) in m, and inflate it."""
        factor = round(RESOLUTION / resolution)
        rows, columns = cells.shape[0] // factor, cells.shape[1] // factor
        coarse = cells[: rows * factor, : columns * factor].reshape(rows, factor, columns, factor)
        costmap = cls((coarse != 0).any(axis=(1, 3)), origin)
        for x, y in points:
            row, column = costmap.cell(x, y)
            if costmap.holds(row, column):
                costmap.blocked[row, column] = True
        costmap.occupied = costmap.blocked
        costmap.blocked = inflated(costmap.blocked, INFLATION / RESOLUTION)
        return costmap

    def cell(self, x, y):
        """Return the row and column of a point in m."""
        return math.floor((y - self.origin[1]) / RESOLUTION), math.floor((x - self.origin[0]) / RESOLUTION)

    def point(self, row, column):
        """Return the centre of a cell in m."""
        return self.origin[0] + (column + 0.5) * RESOLUTION, self.origin[1] + (row + 0.5) * RESOLUTION

    def holds(self, row, column):
        """Whether a cell is on the map."""
        return 0 <= row < self.blocked.shape[0] and 0 <= column < self.blocked.shape[1]

    def is_free(self, x, y):
        """Whether the robot's centre may be at a point."""
        row, column = self.cell(x, y)
        return self.holds(row, column) and not self.blocked[row, column]

    def is_clear(self, start, end):
        """Whether the straight line between two points is free."""
        return all(self.is_free(x, y) for x, y in [start, *_line(start, end, RESOLUTION / 2)])


def inflated(blocked, cells):
    """Grow the blocked cells by a disc of radius `cells`."""
    reach = math.floor(cells)
    padded = np.pad(blocked, reach)
    grown = np.zeros_like(blocked)
    rows, columns = blocked.shape
    for dy in range(-reach, reach + 1):
        for dx in range(-reach, reach + 1):
            if math.hypot(dx, dy) <= cells:
                grown |= padded[reach + dy : reach + dy + rows, reach + dx : reach + dx + columns]
    return grown


def plan(costmap, start, goal):
    """Return a free path [(x, y), …] in m from start to goal; None if there is none.

    A start inside the inflation is allowed, so that a robot close to a wall can leave it.
    """
    if not costmap.is_free(*goal):
        return None
    cells = _search(costmap, costmap.cell(*start), costmap.cell(*goal))
    return cells and shortened(costmap, [start, *(costmap.point(*cell) for cell in cells[1:-1]), goal])


def _search(costmap, start, goal):
    came_from, cost, open_cells = {start: start}, {start: 0.0}, [(0.0, start)]
    closed = set()
    while open_cells:
        _, cell = heapq.heappop(open_cells)
        if cell == goal:
            cells = [cell]
            while came_from[cell] != cell:
                cell = came_from[cell]
                cells.append(cell)
            return cells[::-1]
        if cell in closed:
            continue
        closed.add(cell)
        for neighbour, length in _steps(costmap, cell):
            if cost[cell] + length < cost.get(neighbour, math.inf):
                cost[neighbour], came_from[neighbour] = cost[cell] + length, cell
                heapq.heappush(open_cells, (cost[neighbour] + math.dist(neighbour, goal), neighbour))
    return None


def _steps(costmap, cell):
    """Yield the free neighbours of a cell and their distance; from a blocked cell also blocked ones at a higher cost,
    so that the robot can leave."""
    for dx, dy, length in _NEIGHBOURS:
        row, column = cell[0] + dy, cell[1] + dx
        if costmap.holds(row, column):
            if not costmap.blocked[row, column]:
                yield (row, column), length
            elif costmap.blocked[cell]:
                yield (row, column), 20 * length


def shortened(costmap, path):
    """Remove points of a path that a free straight line can skip."""
    short, last = [path[0]], 0
    while last < len(path) - 1:
        ahead = len(path) - 1
        while ahead > last + 1 and not costmap.is_clear(path[last], path[ahead]):
            ahead -= 1
        short.append(path[ahead])
        last = ahead
    return short


def _line(start, end, spacing):
    """Return points from `start`, exclusive, to `end`, at most `spacing` m apart."""
    (x, y), (to_x, to_y) = start, end
    steps = max(1, math.ceil(math.dist(start, end) / spacing))
    return [(x + step / steps * (to_x - x), y + step / steps * (to_y - y)) for step in range(1, steps + 1)]


class Pursuit:
    """Pure pursuit: steers towards a point of the path that is a little ahead."""

    def __init__(self, path):
        self._points = [path[0]]
        for i in range(len(path) - 1):
            self._points += _line(path[i], path[i + 1], SPACING)
        self._reached = 0

    def remaining(self, pose: Pose):
        """Return the remaining length of the path in m."""
        points = [(pose.x, pose.y), *self.ahead()]
        return sum(math.dist(points[i], points[i + 1]) for i in range(len(points) - 1))

    def ahead(self):
        """Return the points that were not yet passed."""
        return self._points[self._reached :]

    def velocity(self, pose: Pose, fastest, turning):
        """Return the linear (m/s) and angular (rad/s) velocity now, within the two limits."""
        target = self._target(pose)
        distance = math.dist((pose.x, pose.y), target)
        bearing = wrapped(math.atan2(target[1] - pose.y, target[0] - pose.x) - pose.yaw)
        if abs(bearing) > TURN_FIRST:
            return 0.0, math.copysign(min(turning, 2.0 * abs(bearing)), bearing)
        linear = min(fastest * math.cos(bearing) ** 2, 0.05 + 0.8 * self.remaining(pose))
        angular = 2 * linear * math.sin(bearing) / max(distance, 0.1) + 0.5 * bearing
        return linear, max(-turning, min(turning, angular))

    def _target(self, pose):
        here = (pose.x, pose.y)
        window = range(self._reached, min(self._reached + 20, len(self._points)))
        self._reached = min(window, key=lambda i: math.dist(here, self._points[i]))
        return next((point for point in self.ahead() if math.dist(here, point) >= LOOKAHEAD), self._points[-1])
