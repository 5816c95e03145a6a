"""Facts about an occupancy grid (nav_msgs/msg/OccupancyGrid: maps and costmaps)."""

from __future__ import annotations

import math
from dataclasses import dataclass

OCCUPIED_FROM = 50
"""Cells of a map from this percentage on count as occupied, cells below as free: the middle, because a map has no
threshold.
"""


@dataclass(frozen=True, slots=True)
class MapFacts:
    """Size and content of a map: metres per cell, cells, pose of the corner of cell (0, 0), shares of all cells."""

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
        return self.in_words(is_placed=True)

    def in_words(self, *, is_placed: bool) -> str:
        """Return size and content; with `is_placed` also where the map's corner is."""
        size = f"{self.width * self.resolution_m:.2f} m × {self.height * self.resolution_m:.2f} m"
        turned = f", turned by {math.degrees(self.origin_yaw_rad):.1f}°" if abs(self.origin_yaw_rad) > 1e-6 else ""
        corner = f"the lower left corner is at ({self.origin_x_m:.3f}, {self.origin_y_m:.3f}) m{turned}; "
        return (
            f"{self.width} × {self.height} cells of {self.resolution_m:.4g} m ({size}); {corner if is_placed else ''}"
            f"free {self.free:.1%}, occupied {self.occupied:.1%}, unknown {self.unknown:.1%}."
        )
