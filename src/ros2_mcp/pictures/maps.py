"""Draw a nav_msgs/msg/OccupancyGrid."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ros2_mcp.model.occupancy import MapFacts
from ros2_mcp.model.pictures import Bounds, Place
from ros2_mcp.pictures.ground import ROOM_PX, Ground, has_axes, marks_in_words, with_axes
from ros2_mcp.pictures.raster import Raster, magnified
from ros2_mcp.world.occupancy import OccupancyGrid

_UNKNOWN_GREY = 128
"""Half way between free (white) and occupied (black)."""


@dataclass(frozen=True, slots=True)
class MapDrawing:
    """A map as pixels; the map's upper left pixel is at `left_px`, `top_px` of the raster, the rest are axes."""

    raster: Raster
    metres_per_pixel: float
    left_px: int
    top_px: int


def map_raster(message: Any, bounds: Bounds) -> Raster:
    """Draw a map as `map_drawing` does, without the robot."""
    return map_drawing(OccupancyGrid(message), bounds).raster


def map_drawing(grid: OccupancyGrid, bounds: Bounds, robot: Place | None = None) -> MapDrawing:
    """Draw a map with axes and the robot (a place in the frame of the map); a map without a place has neither.

    The first row is at the bottom; free is white, occupied black, unknown grey. Cells are magnified, or pooled with the
    darkest one winning, so that walls stay visible.
    """
    cells, facts = grid.percentages(), grid.facts()
    grey = np.where(cells < 0, _UNKNOWN_GREY, 255 - cells.astype(np.int16) * 255 // 100)
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
    told = facts.in_words(is_placed=not grid.unplaced)
    note = f"Map, {told} White is free, black occupied, grey unknown; x to the right, y up; {scale}."
    if has_axes(bounds.max_side) and not grid.unplaced:
        ground = _ground(facts, metres, robot)
        framed = with_axes(pixels, ground)
        pixels, left, top = framed.pixels, framed.left_px, framed.top_px
        note += f" {marks_in_words(ground)}"
    return MapDrawing(Raster(pixels, note, kind="exact"), metres, left, top)


def _ground(facts: MapFacts, metres_per_pixel: float, robot: Place | None) -> Ground:
    """Return the coordinates of the picture: the frame's, or along the map's sides if the map is rotated."""
    if abs(facts.origin_yaw_rad) < 1e-6:
        return Ground(facts.origin_x_m, facts.origin_y_m, metres_per_pixel, Place(0, 0), robot)
    corner = Place(facts.origin_x_m, facts.origin_y_m, facts.origin_yaw_rad)
    along = ("along the map's lower side", "along its left side")
    return Ground(
        0.0, 0.0, metres_per_pixel, _seen_from(corner, Place(0, 0)), robot and _seen_from(corner, robot), along
    )


def _seen_from(corner: Place, place: Place) -> Place:
    """Transform a place from the frame to the coordinates with origin and orientation of `corner`."""
    dx, dy = place.x_m - corner.x_m, place.y_m - corner.y_m
    cos, sin = math.cos(corner.yaw_rad), math.sin(corner.yaw_rad)
    return Place(cos * dx + sin * dy, cos * dy - sin * dx, place.yaw_rad - corner.yaw_rad)
