"""What it costs to be somewhere, as Nav2's costmaps tell it. No ROS."""

# pyright: basic
from __future__ import annotations

import numpy as np

from .planner import INFLATION, RESOLUTION, inflated

LETHAL, INSCRIBED = 100, 99
"""Of an occupancy grid that is a costmap: the cell is occupied; the robot would touch what is."""
_FALLING = (75, 50, 25, 10)
"""Of the rings around, each a cell wide: the way keeps away from walls where there is room."""


def costs(lethal):
    """Cells (int8) of a costmap around what is occupied: bool (rows, columns), in cells of `RESOLUTION`."""
    cells = np.zeros(lethal.shape, np.int8)
    for ring, cost in reversed([*enumerate(_FALLING, start=1)]):
        cells[inflated(lethal, INFLATION / RESOLUTION + ring)] = cost
    cells[inflated(lethal, INFLATION / RESOLUTION)] = INSCRIBED
    cells[lethal] = LETHAL
    return cells
