"""The colours of maps and costmaps, for pictures and the page: for unknown, and for 0 to 100."""

from __future__ import annotations

import numpy as np

from ros2_mcp.model.costs import OCCUPIED, TOUCHING
from ros2_mcp.pictures.raster import Pixels


def map_colours() -> Pixels:
    """Return the colours from white (free) to black (occupied), 102 × 3: row 0 is unknown, row 1 + n is n %."""
    grey = np.rint(np.linspace(255, 0, 101)).astype(np.uint8)
    return np.vstack(([(200, 200, 200)], np.stack([grey] * 3, axis=1))).astype(np.uint8)


def cost_colours() -> Pixels:
    """Return RViz's colours of costmaps: blue (1) to red (98), inscribed (99) cyan, lethal (100) magenta.

    Free is white.

    The shape is 102 × 3: row 0 is unknown, row 1 + n is cost n.
    """
    share = np.arange(101) / 100
    colours = np.stack((255 * share, np.zeros(101), 255 - 255 * share), axis=1)
    colours[0], colours[TOUCHING], colours[OCCUPIED] = (255, 255, 255), (0, 255, 255), (255, 0, 255)
    # Paler, so that lines, scans and letters are visible on them; inscribed and lethal keep their full colour.
    colours[1:TOUCHING] = 255 - (255 - colours[1:TOUCHING]) * 0.6
    return np.vstack(([(150, 165, 160)], colours)).astype(np.uint8)


def hexadecimal(colours: Pixels, value: int) -> str:
    """Return the colour of a value (-1: unknown), such as `#ff00ff`."""
    return f"#{colours[value + 1].tobytes().hex()}"
