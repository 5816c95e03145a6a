"""Costmaps as Nav2 tells them beside its occupancy grids: raw ones, and the parts that have changed since.

Import it inside functions only: it needs NumPy.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ros2_mcp.model.costs import OCCUPIED, TOUCHING, UNKNOWN
from ros2_mcp.model.errors import BadData
from ros2_mcp.model.nav2 import COSTMAP, COSTMAP_UPDATE
from ros2_mcp.world.costmap import CostGrid

_RAW_TOUCHING, _RAW_OCCUPIED, _RAW_UNKNOWN = 253, 254, 255


def _published() -> NDArray[np.int8]:
    """What Nav2 publishes in an occupancy grid for each raw cost: 1 to 252 become 1 to 98."""
    table = np.zeros(256, np.int8)
    between = np.arange(1, _RAW_TOUCHING)
    table[between] = 1 + 97 * (between - 1) // 251
    table[_RAW_TOUCHING], table[_RAW_OCCUPIED], table[_RAW_UNKNOWN] = TOUCHING, OCCUPIED, UNKNOWN
    return table


_PUBLISHED = _published()


def as_grid(type_name: str, message: Any) -> CostGrid:
    """A whole costmap, raw or not. Raises `BadData` as `OccupancyGrid`."""
    if type_name != COSTMAP:
        return CostGrid(message)
    told = message.metadata
    info = SimpleNamespace(resolution=told.resolution, width=told.size_x, height=told.size_y, origin=told.origin)
    return CostGrid(SimpleNamespace(header=message.header, info=info, data=_cells(True, message.data)))


def updated(grid: CostGrid, type_name: str, update: Any) -> CostGrid:
    """The costmap with a part that has changed. Raises `BadData` if that part does not lie in it."""
    is_raw = type_name == COSTMAP_UPDATE
    width, height = (update.size_x, update.size_y) if is_raw else (update.width, update.height)
    x, y = update.x, update.y
    rows, columns = grid.cells.shape
    if x < 0 or y < 0 or x + width > columns or y + height > rows:
        raise BadData(f"An update of {width} × {height} cells at ({x}, {y}) is outside the costmap.")
    part = _cells(is_raw, update.data)
    if len(part) != width * height:
        raise BadData(f"An update has {len(part)} cells instead of {width} × {height}.")
    cells: NDArray[np.int8] = np.array(grid.cells)  # others may be drawing the former ones
    cells[y : y + height, x : x + width] = np.reshape(part, (height, width))
    return CostGrid(SimpleNamespace(header=grid.header, info=grid.info, data=np.ravel(cells)))


def _cells(is_raw: bool, data: Any) -> NDArray[np.int8]:
    return _PUBLISHED[np.asarray(data, np.uint8)] if is_raw else np.asarray(data, np.int8)
