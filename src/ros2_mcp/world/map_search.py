"""Searches a map for the poses from which a laser scan fits it, coarse to fine over position and heading.

Import it inside functions only: it needs NumPy.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from time import monotonic
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ros2_mcp.world.map_fit import NEAR_M, OCCUPIED, MapFit
from ros2_mcp.world.occupancy import OccupancyGrid, largest_of

MOST_S = 10.0
"""A map of 100 × 100 m takes about 3 s on a laptop; what is not searched by then is told."""
MOST_POSES = 5
"""Number of poses in a result, the best first."""
_NEARLY = 0.08
"""A pose whose `rank` is at most this much below the best one's is nearly as good: people and moved furniture change it
by as much."""
_BEAMS = 120
"""Beams used to search. More cost time and separate poses no better; the fit is measured with all of them."""
_MOST_ADDITIONS = 4e9
"""Bound of the coarse search, in additions of 8 bits; a processor makes some 10^9 in a second."""
_MOST_CELLS = 4_000_000
"""Larger maps are searched in larger cells."""
_LEAST_TURN_RAD, _MOST_TURN_RAD = math.radians(1.5), math.radians(4.0)
_FAR = 0.8
"""Quantile of the ranges that decides the steps of the heading: the few beams beyond may miss."""
_SPOTS = 200
"""Poses of the coarse search that are refined."""
_APART_M, _APART_RAD = 0.4, math.radians(20)
"""Poses nearer to each other than that count as one pose."""
_WIDE_M, _SHARP_M = 0.5, 0.08
"""Distance from a beam's end to the nearest occupied cell at which it counts nothing while a pose is refined, and the
standard deviation in the last steps."""
_END_M = 0.3
"""Part of a beam before its end in which an occupied cell is no contradiction: walls are thick, and poses not exact."""


@dataclass(frozen=True, slots=True)
class FoundPose:
    """A pose in the map from which the scan fits: m, radians.

    `share` of `beams` end near an occupied cell (`map_fit`). `through` is the share of beams that would pass through an
    occupied cell on their way. `rank` orders poses: the share of all beams that end near an occupied cell, less
    `through`; beams that leave the map count as not fitting.
    """

    x_m: float
    y_m: float
    yaw_rad: float
    share: float
    beams: int
    through: float
    rank: float


@dataclass(frozen=True, slots=True)
class MapSearch:
    """The poses found, the best first; `searched` is the share of all headings that were searched in time.

    `rivals` is the number of other poses that are nearly as good as the first.
    """

    poses: Sequence[FoundPose]
    rivals: int
    searched: float
    took_s: float


@dataclass(frozen=True, slots=True)
class Area:
    """The part of the map to search: within `radius_m` of a point, and within `turn_rad` of a heading if a heading is
    given.
    """

    x_m: float
    y_m: float
    radius_m: float
    yaw_rad: float | None = None
    turn_rad: float = math.pi


def search(
    grid: OccupancyGrid, hits: NDArray[np.float64], area: Area | None = None, most_s: float = MOST_S
) -> MapSearch:
    """Return the poses of a frame in the map from which the scan fits the map best.

    Args:
        hits: Ends of beams, n × 2, x and y in m, in that frame, which is on the robot, and has a free cell below it.
        area: What to search; None: the whole map.
        most_s: Time after which the coarse search ends, and `searched` says how far it came.
    """
    began_at = monotonic()
    field = _Field(grid, area)
    chosen = _some(hits)
    reach_m = float(np.quantile(np.hypot(hits[:, 0], hits[:, 1]), _FAR))
    turn = min(_MOST_TURN_RAD, max(_LEAST_TURN_RAD, 2 * NEAR_M / max(reach_m, 0.1)))
    yaws = _headings(area, turn)
    spots, searched = _coarse(field, chosen, yaws, began_at + most_s)
    if not len(spots):
        return MapSearch((), 0, searched, monotonic() - began_at)
    refined = _refined(field, chosen, spots, turn)
    poses = _ranked(field, hits, refined)
    rivals = sum(pose.rank >= poses[0].rank - _NEARLY for pose in poses[1:])
    return MapSearch(poses[:MOST_POSES], rivals, searched, monotonic() - began_at)


def _some(hits: Any) -> Any:
    return hits[np.linspace(0, len(hits) - 1, min(_BEAMS, len(hits))).astype(int)]


class _Field:
    """The map as arrays; poses on it are (row, column, heading) in cells and radians, along the grid's own axes."""

    def __init__(self, grid: OccupancyGrid, area: Area | None) -> None:
        together = max(1, math.ceil(math.sqrt(grid.cells.size / _MOST_CELLS)))
        cells: Any = grid.percentages()
        free: Any = ((cells >= 0) & (cells < OCCUPIED)).astype(np.int8)
        if together > 1:
            free, cells = largest_of(free, together), largest_of(cells, together)
        self.free: Any = free > 0
        self.occupied: Any = cells >= OCCUPIED
        self.cell_m = grid.resolution_m * together
        self.corner = grid.corner
        self.fit = MapFit(grid)
        self.distance: Any = _distances(self.occupied, math.ceil(_WIDE_M / self.cell_m)) * self.cell_m
        if area:
            row, column = self.place(area.x_m, area.y_m)
            rows, columns = np.ogrid[: self.free.shape[0], : self.free.shape[1]]
            near = np.hypot(rows + 0.5 - row, columns + 0.5 - column) <= area.radius_m / self.cell_m
            self.free = self.free & near

    def place(self, x_m: float, y_m: float) -> tuple[float, float]:
        dx, dy = x_m - self.corner.x_m, y_m - self.corner.y_m
        cos, sin = math.cos(self.corner.yaw_rad), math.sin(self.corner.yaw_rad)
        return (cos * dy - sin * dx) / self.cell_m, (cos * dx + sin * dy) / self.cell_m

    def point(self, row: float, column: float) -> tuple[float, float]:
        x, y = column * self.cell_m, row * self.cell_m
        cos, sin = math.cos(self.corner.yaw_rad), math.sin(self.corner.yaw_rad)
        return self.corner.x_m + cos * x - sin * y, self.corner.y_m + sin * x + cos * y

    def ends(self, poses: Any, hits: Any) -> tuple[Any, Any]:
        """Return the rows and columns (n × beams, in cells) of beams' ends for n poses."""
        cos, sin = np.cos(poses[:, 2:3]), np.sin(poses[:, 2:3])
        x, y = hits[:, 0] / self.cell_m, hits[:, 1] / self.cell_m
        return poses[:, 0:1] + sin * x + cos * y, poses[:, 1:2] + cos * x - sin * y

    def at(self, values: NDArray[Any], rows: Any, columns: Any, outside: Any) -> Any:
        """Return the values of cells, and `outside` for cells beside the map."""
        r, c = np.floor(rows).astype(np.int32), np.floor(columns).astype(np.int32)
        height, width = values.shape
        inside = (r >= 0) & (r < height) & (c >= 0) & (c < width)
        return np.where(inside, values[np.where(inside, r, 0), np.where(inside, c, 0)], outside)


def _headings(area: Area | None, turn: float) -> Any:
    if area is None or area.yaw_rad is None or area.turn_rad >= math.pi:
        return np.arange(math.ceil(2 * math.pi / turn)) * turn
    count = max(1, math.ceil(2 * area.turn_rad / turn))
    return area.yaw_rad + np.linspace(-area.turn_rad, area.turn_rad, count + 1)


def _coarse(field: _Field, hits: Any, yaws: Any, deadline: float) -> tuple[Any, float]:
    """Return the best poses on a coarse lattice, n × 3, and the share of the headings that was searched.

    A square of `step` × `step` cells counts a beam as fitting if it fits from any of its cells, so no pose is lost
    between two points of the lattice.
    """
    rows = np.flatnonzero(field.free.any(axis=1))
    columns = np.flatnonzero(field.free.any(axis=0))
    if not len(rows):
        return np.empty((0, 3)), 1.0
    step = max(2, round(NEAR_M / field.cell_m))
    positions = (rows[-1] - rows[0] + 1) * (columns[-1] - columns[0] + 1)
    while positions / step**2 * len(yaws) * len(hits) > _MOST_ADDITIONS:
        step += 1
    top, left = int(rows[0]), int(columns[0])
    height, width = -(-(int(rows[-1]) + 1 - top) // step), -(-(int(columns[-1]) + 1 - left) // step)
    reach = math.ceil(float(np.hypot(hits[:, 0], hits[:, 1]).max()) / field.cell_m) + 1
    phases = _phases(field, top, left, (height, width), reach, step)
    free = _any_in_squares(field.free[top:, left:], height, width, step)
    found: list[Any] = []
    middle = (step - 1) / 2 + 0.5
    for yaw in yaws - field.corner.yaw_rad:
        ends_y, ends_x = field.ends(np.array([[0.0, 0.0, yaw]]), hits)
        score = np.zeros((height, width), np.uint8)
        offsets = np.stack((np.rint(ends_y[0]), np.rint(ends_x[0])), axis=1).astype(int) + reach
        for down, right in offsets.tolist():
            (i, p), (j, q) = divmod(down, step), divmod(right, step)
            score += phases[p, q, i : i + height, j : j + width]
        score[~free] = 0
        least = max(int(score.max()) - len(hits) // 4, 1)
        i, j = np.nonzero(_is_peak(score) & (score >= least))
        best = np.argsort(score[i, j])[::-1][: _SPOTS // 2]
        i, j = i[best], j[best]
        spots = (top + i * step + middle, left + j * step + middle, np.full(len(i), yaw), score[i, j])
        found.append(np.stack(spots, axis=1).astype(float))
        if monotonic() > deadline:
            break
    return _apart(np.concatenate(found), _SPOTS, _APART_M / field.cell_m), len(found) / len(yaws)


def _phases(field: _Field, top: int, left: int, size: tuple[int, int], reach: int, step: int) -> Any:
    """Return which cells are near an occupied cell from anywhere in a square, split by the place in the square: step ×
    step × rows × columns. So the ends of one beam for all squares are a slice of contiguous rows.
    """
    near = (field.distance <= NEAR_M).astype(np.uint8)
    for axis in (0, 1):
        room = [(0, step - 1) if axis == along else (0, 0) for along in (0, 1)]
        windows = np.lib.stride_tricks.sliding_window_view(np.pad(near, room), step, axis=axis)
        near = windows.max(axis=-1)
    high, wide = ((count + 2 * reach // step + 2) * step for count in size)
    around: Any = np.zeros((high, wide), np.uint8)
    first_row, first_column = top - reach, left - reach
    from_row, from_column = max(first_row, 0), max(first_column, 0)
    part = near[from_row : first_row + high, from_column : first_column + wide]
    down, right = from_row - first_row, from_column - first_column
    around[down : down + part.shape[0], right : right + part.shape[1]] = part
    split = around.reshape(high // step, step, wide // step, step)
    return np.ascontiguousarray(split.transpose(1, 3, 0, 2))


def _any_in_squares(cells: Any, height: int, width: int, step: int) -> Any:
    whole: Any = np.zeros((height * step, width * step), np.bool_)
    part = cells[: height * step, : width * step]
    whole[: part.shape[0], : part.shape[1]] = part
    return whole.reshape(height, step, width, step).any(axis=(1, 3))


def _is_peak(score: Any) -> Any:
    """Return which values are not less than the values around them."""
    most = score
    for axis in (0, 1):
        room = [(1, 1) if axis == along else (0, 0) for along in (0, 1)]
        most = np.lib.stride_tricks.sliding_window_view(np.pad(most, room), 3, axis=axis).max(axis=-1)
    return score == most


def _apart(spots: Any, most: int, apart: float) -> Any:
    """Return the best of poses with a score (n × 4) that are apart from each other, as n × 3."""
    spots = spots[np.argsort(spots[:, 3])[::-1]]
    kept: list[Any] = []
    while len(spots) and len(kept) < most:
        first = spots[0]
        kept.append(first[:3])
        spots = spots[~_is_same(spots, first, apart)]
    found: Any = np.array(kept)
    return found.reshape(-1, 3)


def _is_same(poses: Any, one: Any, apart: float) -> Any:
    away = np.hypot(poses[:, 0] - one[0], poses[:, 1] - one[1])
    turned = np.abs(np.remainder(poses[:, 2] - one[2] + math.pi, 2 * math.pi) - math.pi)
    return (away < apart) & (turned < _APART_RAD)


def _refined(field: _Field, hits: Any, spots: Any, turn: float) -> Any:
    """Return poses moved to where the scan fits best around them, n × 4, with their score."""
    steps: list[tuple[float, float]] = []
    cells, angle = NEAR_M / 2 / field.cell_m, turn / 2
    for _ in range(4):
        steps += [(cells, angle)] * 2
        cells, angle = cells / 2, angle / 2
    moves = np.array([(y, x, t) for y in (-1, 0, 1) for x in (-1, 0, 1) for t in (-1, 0, 1)], float)
    wide: Any = np.maximum(1 - field.distance / _WIDE_M, 0).astype(np.float32)
    sharp = np.exp(-0.5 * (field.distance / _SHARP_M) ** 2).astype(np.float32)
    score = np.zeros(len(spots))
    for index, (cells, angle) in enumerate(steps):
        values = wide if index < len(steps) // 2 else sharp
        around = spots[:, None, :] + moves * (cells, cells, angle)
        scores = np.empty(around.shape[:2])
        for number in range(len(moves)):
            rows, columns = field.ends(around[:, number], hits)
            scores[:, number] = field.at(values, rows, columns, 0.0).mean(axis=1)
        best = scores.argmax(axis=1)
        spots = around[np.arange(len(spots)), best]
        score = scores[np.arange(len(spots)), best]
        if index == len(steps) // 2:  # most have shown by now that they are worse
            chosen = np.argsort(score)[::-1][: _SPOTS // 4]
            spots, score = spots[chosen], score[chosen]
    return np.column_stack((spots, score))


def _ranked(field: _Field, hits: Any, refined: Any) -> Sequence[FoundPose]:
    kept = _apart(refined, 4 * MOST_POSES, _APART_M / field.cell_m)
    kept = kept[field.at(field.free, kept[:, 0], kept[:, 1], False)]
    found: list[FoundPose] = []
    few = _some(hits)
    for pose in kept:
        x_m, y_m = field.point(pose[0], pose[1])
        yaw = math.remainder(float(pose[2]) + field.corner.yaw_rad, 2 * math.pi)
        share, beams = field.fit.share(hits, x_m, y_m, yaw)
        through = _through(field, pose, few)
        rank = share * beams / len(hits) - through
        found.append(FoundPose(x_m, y_m, yaw, share, beams, through, rank))
    return sorted(found, key=lambda one: -one.rank)


def _through(field: _Field, pose: Any, hits: Any) -> float:
    """Return the share of beams that would pass through an occupied cell well before their end."""
    lengths = np.hypot(hits[:, 0], hits[:, 1])
    samples = np.arange(0.0, max(lengths.max() - _END_M, field.cell_m), field.cell_m * 0.7)
    counts = samples[None, :] < (lengths - _END_M)[:, None]
    ways = samples[None, :] / np.maximum(lengths, 1e-6)[:, None]
    rows, columns = field.ends(pose[None, :], hits)
    rows, columns = pose[0] + (rows[0] - pose[0])[:, None] * ways, pose[1] + (columns[0] - pose[1])[:, None] * ways
    crossed = field.at(field.occupied, rows, columns, False) & counts
    return float((crossed.sum(axis=1) > 0).mean())


def _distances(occupied: Any, most: int) -> Any:
    """Return the distance in cells from each cell to the nearest occupied cell, at most `most`."""
    within: Any = np.where(occupied, 0, most).astype(np.float32)
    for axis in (0, 1):
        square: Any = within**2
        nearest = square.copy()
        for shift in range(1, most):
            ahead, behind = [slice(None)] * 2, [slice(None)] * 2
            ahead[axis], behind[axis] = slice(shift, None), slice(None, -shift)
            if square.shape[axis] <= shift:
                break
            here, there = tuple(ahead), tuple(behind)
            nearest[here] = np.minimum(nearest[here], square[there] + shift**2)
            nearest[there] = np.minimum(nearest[there], square[here] + shift**2)
        within = np.sqrt(nearest)
    return np.minimum(within, most)
