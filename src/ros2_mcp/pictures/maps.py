"""nav_msgs/msg/OccupancyGrid as a picture and as facts."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ros2_mcp.model.errors import BadData
from ros2_mcp.model.pictures import Bounds, Place
from ros2_mcp.pictures.ground import ROOM_PX, Ground, has_axes, marks_in_words, with_axes
from ros2_mcp.pictures.raster import Raster, magnified
from ros2_mcp_common.geometry import yaw_rad

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
    yaw = yaw_rad(turn.x, turn.y, turn.z, turn.w)
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


@dataclass(frozen=True, slots=True)
class MapDrawing:
    """A map as pixels; its upper left one is at `left_px`, `top_px` of the raster, the rest are axes."""

    raster: Raster
    metres_per_pixel: float
    left_px: int
    top_px: int


def map_raster(message: Any, bounds: Bounds) -> Raster:
    """The map as `map_drawing` draws it, without the robot."""
    return map_drawing(message, bounds).raster


def map_drawing(message: Any, bounds: Bounds, robot: Place | None = None) -> MapDrawing:
    """The map with its first row at the bottom, free white, occupied black, unknown grey; axes, and the robot (a place
    in the frame of the map).

    Cells are magnified, or taken together with the darkest one winning, so that walls stay visible.
    """
    cells, facts = _cells(message), map_facts(message)
    grey = np.where((cells < 0) | (cells > 100), _UNKNOWN_GREY, 255 - cells.astype(np.int16) * 255 // 100)
    pixels, side = grey.astype(np.uint8), max(grey.shape)
    most = bounds.max_side - ROOM_PX if has_axes(bounds.max_side) else bounds.max_side
    if side > most:
        together = -(-side // most)
        metres = facts.resolution_m * together
        for axis, length in enumerate(grey.shape):  # the squares at the top and the right may be smaller
            pixels = np.minimum.reduceat(pixels, range(0, length, together), axis=axis)
        scale = f"one pixel is {together} × {together} cells"
    else:
        pixels, times = magnified(pixels, most)
        metres = facts.resolution_m / times
        scale = f"one cell is {times} × {times} pixels"
    pixels, left, top = np.flipud(pixels), 0, 0
    note = f"Map, {facts} White is free, black occupied, grey unknown; x to the right, y up; {scale}."
    if has_axes(bounds.max_side):
        ground = _ground(facts, metres, robot)
        framed = with_axes(pixels, ground)
        pixels, left, top = framed.pixels, framed.left_px, framed.top_px
        note += f" {marks_in_words(ground)}"
    return MapDrawing(Raster(pixels, note, kind="exact"), metres, left, top)


def _ground(facts: MapFacts, metres_per_pixel: float, robot: Place | None) -> Ground:
    """The coordinates of the picture: the frame's, or those along the map's sides where the map is turned in it."""
    if abs(facts.origin_yaw_rad) < 1e-6:
        return Ground(facts.origin_x_m, facts.origin_y_m, metres_per_pixel, Place(0, 0), robot)
    corner = Place(facts.origin_x_m, facts.origin_y_m, facts.origin_yaw_rad)
    along = ("along the map's lower side", "along its left side")
    return Ground(
        0.0, 0.0, metres_per_pixel, _seen_from(corner, Place(0, 0)), robot and _seen_from(corner, robot), along
    )


def _seen_from(corner: Place, place: Place) -> Place:
    """A place of the frame in the coordinates that begin at `corner` and are turned as it is."""
    dx, dy = place.x_m - corner.x_m, place.y_m - corner.y_m
    cos, sin = math.cos(corner.yaw_rad), math.sin(corner.yaw_rad)
    return Place(cos * dx + sin * dy, cos * dy - sin * dx, place.yaw_rad - corner.yaw_rad)


def _cells(message: Any) -> NDArray[np.int8]:
    width, height = message.info.width, message.info.height
    if not width or not height:
        raise BadData(f"The map is empty: {width} × {height} cells.")
    if len(message.data) != width * height:
        raise BadData(
            f"data has {len(message.data)} cells, but width × height is {width} × {height} = {width * height}."
        )
    return message.data.reshape(height, width)
