"""nav_msgs/msg/OccupancyGrid, validated once, with its pose in its frame. Used for maps, costmaps and programs.

Import it inside functions only: it needs NumPy.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ros2_mcp.model.errors import BadData
from ros2_mcp.model.occupancy import OCCUPIED_FROM, MapFacts
from ros2_mcp.model.pictures import Place
from ros2_mcp.model.poses import Pose
from ros2_mcp.world.transforms import pose_of
from ros2_mcp_common.finite import not_finite


class OccupancyGrid:
    """The cells of one message, with their pose in its frame.

    `cells` are height × width as in the message, the first row at the least y; `origin` is the pose of the corner of
    cell (0, 0), `corner` the same in the plane. `frame_id` has no leading slash.
    """

    def __init__(self, message: Any, *, needs_place: bool = True) -> None:
        """Read the `header`, `info` and `data` of a message.

        Without `needs_place`, a grid whose origin is no pose begins at (0, 0), and `unplaced` says why.

        Raises:
            BadData: if the grid is empty, its data does not fit its size, its resolution is not positive, or its
                resolution is not finite; with `needs_place`, also if its origin is no pose.
        """
        info = message.info
        width, height, count = info.width, info.height, len(message.data)
        if not width or not height:
            raise BadData(f"The grid is empty: {width} × {height} cells.")
        if count != width * height:
            raise BadData(
                f"The grid's data has {count} cells, but width × height is {width} × {height} = {width * height}."
            )
        if why := not_finite(info, "resolution", within="info"):
            raise BadData(f"The grid's resolution is not finite ({why}): nothing can be placed on it.")
        resolution_m = float(info.resolution)
        if resolution_m <= 0:
            raise BadData(f"The grid's resolution is {resolution_m:g} m for a cell: nothing can be placed on it.")
        self.origin, self.unplaced = _origin_of(info)
        if self.unplaced and needs_place:
            raise BadData(f"{self.unplaced}: nothing can be placed on it.")
        self.header: Any = message.header
        self.info: Any = info
        self.frame_id: str = message.header.frame_id.lstrip("/")
        self.resolution_m = resolution_m
        self.corner = Place(self.origin.translation[0], self.origin.translation[1], self.origin.yaw_rad)
        data: Any = np.asarray(message.data, np.int8)
        self.cells: NDArray[np.int8] = data.reshape(height, width)

    def cell(self, x_m: float, y_m: float) -> tuple[int, int]:
        """Return row and column of a point, which may be outside of the grid."""
        dx, dy = x_m - self.corner.x_m, y_m - self.corner.y_m
        cos, sin = math.cos(self.corner.yaw_rad), math.sin(self.corner.yaw_rad)
        return (
            math.floor((cos * dy - sin * dx) / self.resolution_m),
            math.floor((cos * dx + sin * dy) / self.resolution_m),
        )

    def point(self, row: float, column: float) -> tuple[float, float]:
        """Return the centre of a cell, in m."""
        x, y = (column + 0.5) * self.resolution_m, (row + 0.5) * self.resolution_m
        cos, sin = math.cos(self.corner.yaw_rad), math.sin(self.corner.yaw_rad)
        return self.corner.x_m + cos * x - sin * y, self.corner.y_m + sin * x + cos * y

    def value(self, x_m: float, y_m: float) -> int | None:
        """Return the value of the cell at a point; None outside of the grid."""
        row, column = self.cell(x_m, y_m)
        rows, columns = self.cells.shape
        return int(self.cells[row, column]) if 0 <= row < rows and 0 <= column < columns else None

    def nearest(self, x_m: float, y_m: float, least: int, most: int) -> tuple[int, int] | None:
        """Return row and column of the nearest cell with a value from `least` to `most`; None if there is none.

        Rows are searched one by one, outwards from the row of the point: all hits of a map of 16 million cells at once
        would take too much memory.
        """
        row, column = self.cell(x_m, y_m)
        found: tuple[int, int] | None = None
        nearest = math.inf
        for other in sorted(range(len(self.cells)), key=lambda each: abs(each - row)):
            if (other - row) ** 2 >= nearest:
                break
            line = self.cells[other]
            hits = np.flatnonzero((line >= least) & (line <= most))
            if len(hits):
                hit = int(hits[np.argmin(np.abs(hits - column))])
                if (distance := (other - row) ** 2 + (hit - column) ** 2) < nearest:
                    nearest, found = distance, (other, hit)
        return found

    def rows(self, together: int) -> list[list[int]]:
        """Return the values by rows, the lowest first, with the largest of each `together` × `together` cells."""
        return largest_of(self.cells, together).tolist()

    def extent(self) -> str:
        """Return the extent in words, in m."""
        rows, columns = self.cells.shape
        corners = [self.point(row, column) for row in (-0.5, rows - 0.5) for column in (-0.5, columns - 0.5)]
        xs, ys = [x for x, _ in corners], [y for _, y in corners]
        return f"x {min(xs):.2f} to {max(xs):.2f}, y {min(ys):.2f} to {max(ys):.2f}"

    def facts(self) -> MapFacts:
        """Return the size, pose and content of the grid in numbers."""
        free = float(np.mean((self.cells >= 0) & (self.cells < OCCUPIED_FROM)))
        occupied = float(np.mean((self.cells >= OCCUPIED_FROM) & (self.cells <= 100)))
        height, width = self.cells.shape
        return MapFacts(
            self.frame_id,
            self.resolution_m,
            width,
            height,
            self.corner.x_m,
            self.corner.y_m,
            self.corner.yaw_rad,
            free,
            occupied,
            max(0.0, 1 - free - occupied),
        )

    def percentages(self) -> NDArray[np.int8]:
        """Return the cells as 0 to 100, with -1 (unknown) for every other value."""
        return np.where((self.cells < 0) | (self.cells > 100), np.int8(-1), self.cells)


def largest_of(cells: NDArray[np.int8], together: int) -> NDArray[np.int8]:
    """Return the largest value of each square of `together` × `together` cells.

    Squares at the far sides may be smaller.
    """
    for axis, length in enumerate(cells.shape):
        cells = np.maximum.reduceat(cells, range(0, length, together), axis=axis)
    return cells


def _origin_of(info: Any) -> tuple[Pose, str]:
    """Return the pose of the corner of cell (0, 0), and why it is unknown, if it is."""
    if why := not_finite(info, "origin", within="info"):
        return Pose(), f"The grid's origin is not finite ({why})"
    try:
        return pose_of(info.origin), ""
    except ValueError as error:
        return Pose(), f"The grid's origin is not a pose ({error})"
