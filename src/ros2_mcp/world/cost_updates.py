"""Costmaps as Nav2 tells them beside its occupancy grids: raw ones, and the parts that have changed since.

Import it inside functions only: it needs NumPy.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ros2_mcp.model.costs import OCCUPIED, TOUCHING, UNKNOWN
from ros2_mcp.model.errors import BadData
from ros2_mcp.model.nav2 import COSTMAP, COSTMAP_UPDATE

_RAW_TOUCHING, _RAW_OCCUPIED, _RAW_UNKNOWN = 253, 254, 255


def _published() -> NDArray[np.int8]:
    """What Nav2 publishes in an occupancy grid for each raw cost: 1 to 252 become 1 to 98."""
    table = np.zeros(256, np.int8)
    between = np.arange(1, _RAW_TOUCHING)
    table[between] = 1 + 97 * (between - 1) // 251
    table[_RAW_TOUCHING], table[_RAW_OCCUPIED], table[_RAW_UNKNOWN] = TOUCHING, OCCUPIED, UNKNOWN
    return table


_PUBLISHED = _published()


@dataclass(frozen=True, slots=True)
class Grid:
    """A costmap with the fields of nav_msgs/msg/OccupancyGrid that are used."""

    header: Any
    info: Any
    data: NDArray[np.int8]


def as_grid(type_name: str, message: Any) -> Grid:
    """A whole costmap, raw or not. Raises `BadData` if its cells do not fit its size."""
    if type_name == COSTMAP:
        told = message.metadata
        info: Any = SimpleNamespace(
            resolution=told.resolution, width=told.size_x, height=told.size_y, origin=told.origin
        )
    else:
        info = message.info
    cells = _cells(type_name == COSTMAP, message.data)
    if len(cells) != info.width * info.height:
        raise BadData(f"The costmap has {len(cells)} cells instead of {info.width} × {info.height}.")
    return Grid(message.header, info, cells)


def updated(grid: Grid, type_name: str, update: Any) -> Grid:
    """The costmap with a part that has changed. Raises `BadData` if that part does not lie in it."""
    is_raw = type_name == COSTMAP_UPDATE
    width, height = (update.size_x, update.size_y) if is_raw else (update.width, update.height)
    x, y = update.x, update.y
    if x < 0 or y < 0 or x + width > grid.info.width or y + height > grid.info.height:
        raise BadData(f"An update of {width} × {height} cells at ({x}, {y}) is outside the costmap.")
    part = _cells(is_raw, update.data)
    if len(part) != width * height:
        raise BadData(f"An update has {len(part)} cells instead of {width} × {height}.")
    data: NDArray[np.int8] = np.array(grid.data)  # others may be drawing the former one
    rows: NDArray[np.int8] = np.reshape(data, (grid.info.height, grid.info.width))
    rows[y : y + height, x : x + width] = np.reshape(part, (height, width))
    return replace(grid, data=data)


def _cells(is_raw: bool, data: Any) -> NDArray[np.int8]:
    return _PUBLISHED[np.asarray(data, np.uint8)] if is_raw else np.asarray(data, np.int8)
