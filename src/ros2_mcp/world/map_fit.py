"""How well the ends of laser beams fit an occupancy grid: one measure for all who judge a localisation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from ros2_mcp.world.costmap import CostGrid
    from ros2_mcp.world.occupancy import OccupancyGrid

NEAR_M = 0.15
"""From a beam's end to an occupied cell: a cell, the noise of the scanner, and the error of a settled localisation."""
OCCUPIED = 65
"""In percent, the `occupied_thresh` of 0.65 that map_server uses by default."""


def share_that_fits(
    grid: CostGrid | OccupancyGrid,
    hits: Sequence[Sequence[float]],
    x_m: float = 0.0,
    y_m: float = 0.0,
    yaw_rad: float = 0.0,
) -> tuple[float, int]:
    """Return the share of beam ends near an occupied cell of the map, and the number of beams it is based on.

    Beams that end outside the map do not count. If all of them do, the share is 0 of all beams: the estimated pose is
    outside the map.

    Args:
        hits: Ends of beams, x and y in m, in a frame whose pose in the map is `x_m`, `y_m`, `yaw_rad`.
    """
    return MapFit(grid).share(hits, x_m, y_m, yaw_rad)


class MapFit:
    """The measure on one map, for several poses. `near` is, for each cell, whether an occupied cell is within `NEAR_M`
    along rows and columns.
    """

    def __init__(self, grid: CostGrid | OccupancyGrid) -> None:
        self.grid = grid
        self.near = _near_occupied(grid)

    def share(
        self, hits: Sequence[Sequence[float]] | NDArray[np.float64], x_m: float, y_m: float, yaw_rad: float
    ) -> tuple[float, int]:
        """As `share_that_fits`."""
        grid = self.grid
        cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
        points: Any = np.asarray(hits)
        in_map_x, in_map_y = (
            x_m + cos * points[:, 0] - sin * points[:, 1],
            y_m + sin * points[:, 0] + cos * points[:, 1],
        )
        turned = grid.corner.yaw_rad
        dx, dy = in_map_x - grid.corner.x_m, in_map_y - grid.corner.y_m
        columns = np.floor((math.cos(turned) * dx + math.sin(turned) * dy) / grid.resolution_m).astype(int)
        rows = np.floor((math.cos(turned) * dy - math.sin(turned) * dx) / grid.resolution_m).astype(int)
        height, width = grid.cells.shape
        on_map = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
        if not on_map.any():
            return 0.0, len(hits)
        return float(self.near[rows[on_map], columns[on_map]].mean()), int(on_map.sum())


def _near_occupied(grid: CostGrid | OccupancyGrid) -> Any:
    near: Any = grid.cells >= OCCUPIED
    reach = max(1, round(NEAR_M / grid.resolution_m))
    for axis in (0, 1):
        room = [(reach, reach) if axis == along else (0, 0) for along in (0, 1)]
        windows = np.lib.stride_tricks.sliding_window_view(np.pad(near, room), 2 * reach + 1, axis=axis)
        near = windows.any(axis=-1)
    return near
