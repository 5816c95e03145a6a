"""Costs of cells, as in Nav2's costmaps. No ROS."""

# pyright: basic
from __future__ import annotations

import numpy as np

from .planner import INFLATION, RESOLUTION, inflated

LETHAL, INSCRIBED = 100, 99
"""Costs in an occupancy grid: the cell is occupied; the robot would touch an occupied cell."""
_FALLING = (75, 50, 25, 10)
"""Costs of the rings around, each one cell wide: paths keep away from walls where there is room."""


def costs(lethal):
    """Return the costs (int8) around occupied cells: `lethal` is bool (rows, columns), in cells of `RESOLUTION`."""
    cells = np.zeros(lethal.shape, np.int8)
    for ring, cost in reversed([*enumerate(_FALLING, start=1)]):
        cells[inflated(lethal, INFLATION / RESOLUTION + ring)] = cost
    cells[inflated(lethal, INFLATION / RESOLUTION)] = INSCRIBED
    cells[lethal] = LETHAL
    return cells
