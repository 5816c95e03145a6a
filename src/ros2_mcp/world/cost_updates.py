"""Nav2's further forms of costmaps: raw costmaps, and updates of a part of a costmap.

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
    """Return the table from raw costs (0 to 255) to the values of Nav2's occupancy grids: 1 to 252 become 1 to 98."""
    table = np.zeros(256, np.int8)
    between = np.arange(1, _RAW_TOUCHING)
    table[between] = 1 + 97 * (between - 1) // 251
    table[_RAW_TOUCHING], table[_RAW_OCCUPIED], table[_RAW_UNKNOWN] = TOUCHING, OCCUPIED, UNKNOWN
    return table


_PUBLISHED = _published()


def as_grid(type_name: str, message: Any) -> CostGrid:
    """Convert a whole costmap, raw or not. Raises `BadData` as `OccupancyGrid` does."""
    if type_name != COSTMAP:
        return CostGrid(message)
    told = message.metadata
    info = SimpleNamespace(resolution=told.resolution, width=told.size_x, height=told.size_y, origin=told.origin)
    return CostGrid(SimpleNamespace(header=message.header, info=info, data=_cells(True, message.data)))


def updated(grid: CostGrid, type_name: str, update: Any) -> CostGrid:
    """Return the costmap with an update applied. Raises `BadData` if the update does not lie inside the costmap."""
    is_raw = type_name == COSTMAP_UPDATE
    width, height = (update.size_x, update.size_y) if is_raw else (update.width, update.height)
    x, y = update.x, update.y
    rows, columns = grid.cells.shape
    if x < 0 or y < 0 or x + width > columns or y + height > rows:
        raise BadData(f"An update of {width} × {height} cells at ({x}, {y}) is outside the costmap.")
    part = _cells(is_raw, update.data)
    if len(part) != width * height:
        raise BadData(f"An update has {len(part)} cells instead of {width} × {height}.")
    cells: NDArray[np.int8] = np.array(grid.cells)  # a copy: the former cells may be being drawn
    cells[y : y + height, x : x + width] = np.reshape(part, (height, width))
    return CostGrid(SimpleNamespace(header=grid.header, info=grid.info, data=np.ravel(cells)))


def _cells(is_raw: bool, data: Any) -> NDArray[np.int8]:
    return _PUBLISHED[np.asarray(data, np.uint8)] if is_raw else np.asarray(data, np.int8)
