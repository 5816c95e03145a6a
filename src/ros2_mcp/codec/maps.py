"""nav_msgs/msg/OccupancyGrid as a picture and as facts."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ros2_mcp.codec.raster import Raster, magnified
from ros2_mcp.model.errors import BadData
from ros2_mcp.model.pictures import Bounds

OCCUPIED = 50
"""Cells from this percentage on count as occupied, below as free: the middle, as a map tells no threshold."""
_UNKNOWN_GREY = 128
"""Half way between free (white) and occupied (black)."""


@dataclass(frozen=True, slots=True)
class MapFacts:
    """Size and content of a map: metres per cell, cells, the pose of cell (0, 0)'s corner, shares of all cells."""

    frame_id: str
    resolution_m: float
    width: int
    height: int
    origin_x_m: float
    origin_y_m: float
    origin_yaw_rad: float
    free: float
    occupied: float
    unknown: float

    def __str__(self) -> str:
        size = f"{self.width * self.resolution_m:.2f} m × {self.height * self.resolution_m:.2f} m"
        turned = f", turned by {math.degrees(self.origin_yaw_rad):.1f}°" if abs(self.origin_yaw_rad) > 1e-6 else ""
        return (
            f"{self.width} × {self.height} cells of {self.resolution_m:.4g} m ({size}); the lower left corner is at "
            f"({self.origin_x_m:.3f}, {self.origin_y_m:.3f}) m{turned}; "
            f"free {self.free:.1%}, occupied {self.occupied:.1%}, unknown {self.unknown:.1%}."
        )


def map_facts(message: Any) -> MapFacts:
    """What can be said about an occupancy grid in numbers.

    Raises:
        BadData: if its data does not fit its width and height.
    """
    cells = _cells(message)
    info = message.info
    free = float(np.mean((cells >= 0) & (cells < OCCUPIED)))
    occupied = float(np.mean((cells >= OCCUPIED) & (cells <= 100)))
    position, turn = info.origin.position, info.origin.orientation
    yaw = math.atan2(2 * (turn.w * turn.z + turn.x * turn.y), turn.w**2 + turn.x**2 - turn.y**2 - turn.z**2)
    return MapFacts(
        message.header.frame_id,
        float(info.resolution),
        info.width,
        info.height,
        position.x,
        position.y,
        yaw,
        free,
        occupied,
        max(0.0, 1 - free - occupied),
    )


def map_raster(message: Any, bounds: Bounds) -> Raster:
    """The map with its first row at the bottom: free white, occupied black, unknown grey.

    Cells are magnified, or taken together with the darkest one winning, so that walls stay visible.
    """
    cells = np.flipud(_cells(message))
    grey = np.where((cells < 0) | (cells > 100), _UNKNOWN_GREY, 255 - cells.astype(np.int16) * 255 // 100)
    pixels, side = grey.astype(np.uint8), max(grey.shape)
    if side > bounds.max_side:
        together = -(-side // bounds.max_side)
        for axis, length in enumerate(grey.shape):  # the squares at the top and the right may be smaller
            pixels = np.minimum.reduceat(pixels, range(0, length, together), axis=axis)
        scale = f"one pixel is {together} × {together} cells"
    else:
        pixels, times = magnified(pixels, bounds.max_side)
        scale = f"one cell is {times} × {times} pixels"
    note = f"Map, {map_facts(message)} White is free, black occupied, grey unknown; x to the right, y up; {scale}."
    return Raster(pixels, note, kind="exact")


def _cells(message: Any) -> NDArray[np.int8]:
    width, height = message.info.width, message.info.height
    if not width or not height:
        raise BadData(f"The map is empty: {width} × {height} cells.")
    if len(message.data) != width * height:
        raise BadData(
            f"data has {len(message.data)} cells, but width × height is {width} × {height} = {width * height}."
        )
    return message.data.reshape(height, width)
