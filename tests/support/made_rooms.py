"""Rooms with inner walls and boxes, their maps, and what a laser scanner sees in them: made here, without ROS."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ros2_mcp.world.occupancy import OccupancyGrid
from ros2_mcp_demo.world import Box, cast_segments, rectangle

MARGIN_M = 0.3
"""Of the map around the room."""


class Room:
    """A room of `width` × `height` m with its corner at (0, 0). `mapped` things are on its map, `others` are not."""

    def __init__(self, width: float, height: float, mapped: list[Box] | None = None) -> None:
        self.width, self.height = width, height
        self.mapped: list[Box] = mapped or []
        self.others: list[Box] = []

    @classmethod
    def random(cls, rng: np.random.Generator) -> Room:
        """A room with two to four inner walls and three to six boxes."""
        room = cls(rng.uniform(6, 12), rng.uniform(5, 9))
        wide, high = room.width, room.height
        for _ in range(rng.integers(2, 5)):
            length = rng.uniform(1, min(wide, high) * 0.6)
            if rng.random() < 0.5:
                room.mapped.append(
                    _box(rng.uniform(1, wide - 1), rng.choice([length / 2, high - length / 2]), 0.1, length)
                )
            else:
                room.mapped.append(
                    _box(rng.choice([length / 2, wide - length / 2]), rng.uniform(1, high - 1), length, 0.1)
                )
        for _ in range(rng.integers(3, 7)):
            at = rng.uniform(0.5, wide - 0.5), rng.uniform(0.5, high - 0.5)
            room.mapped.append(_box(*at, rng.uniform(0.2, 1), rng.uniform(0.2, 1)))
        return room

    def visit(self, rng: np.random.Generator, people: int) -> None:
        """Put things into the room that are not on its map."""
        for _ in range(people):
            self.others.append(_box(*self.free(rng), 0.35, 0.35))

    def free(self, rng: np.random.Generator) -> tuple[float, float]:
        """A point with 0.3 m around it."""
        while True:
            x, y = rng.uniform(0.3, self.width - 0.3), rng.uniform(0.3, self.height - 0.3)
            if all(float(box.distance(x, y)) > 0.3 for box in (*self.mapped, *self.others)):
                return x, y

    def map(self, resolution: float = 0.05) -> OccupancyGrid:
        """Its map."""
        columns, rows = (round((side + 2 * MARGIN_M) / resolution) for side in (self.width, self.height))
        x = -MARGIN_M + (np.arange(columns) + 0.5) * resolution
        y = (-MARGIN_M + (np.arange(rows) + 0.5) * resolution)[:, np.newaxis]
        outside = np.maximum(np.maximum(-x, x - self.width), np.maximum(-y, y - self.height))
        solid = outside > 0
        for box in self.mapped:
            solid |= box.distance(x, y) <= resolution / 4
        cells = np.where(solid, 100, 0).astype(np.int8)
        cells[outside > resolution] = -1
        return made_grid(cells, resolution, -MARGIN_M, -MARGIN_M)

    def scan(self, rng: np.random.Generator, x: float, y: float, yaw: float, reach: float = 8.0) -> NDArray[np.float64]:
        """The ends of a scanner's beams in its own frame, n × 2: one beam each degree, with noise and gaps."""
        angles = -math.pi + np.arange(360) * math.radians(1)
        walls = np.vstack([rectangle(0, 0, self.width, self.height), *(box.edges() for box in self._things())])
        ranges = cast_segments(x, y, yaw + angles, walls)[0] + 0.015 * rng.standard_normal(len(angles))
        hit = (ranges < reach) & (rng.random(len(angles)) > 0.02)
        return np.stack((ranges * np.cos(angles), ranges * np.sin(angles)), axis=1)[hit]

    def _things(self) -> list[Box]:
        return [*self.mapped, *self.others]


def made_grid(cells: NDArray[np.int8], resolution: float, x: float, y: float, yaw: float = 0.0) -> OccupancyGrid:
    """A map with its corner at a pose."""
    position = SimpleNamespace(x=x, y=y, z=0.0)
    orientation = SimpleNamespace(x=0.0, y=0.0, z=math.sin(yaw / 2), w=math.cos(yaw / 2))
    origin = SimpleNamespace(position=position, orientation=orientation)
    rows, columns = cells.shape
    info = SimpleNamespace(width=columns, height=rows, resolution=resolution, origin=origin)
    message: Any = SimpleNamespace(header=SimpleNamespace(frame_id="map"), info=info, data=cells.ravel().tolist())
    return OccupancyGrid(message)


def _box(x: float, y: float, size_x: float, size_y: float) -> Box:
    return Box("", x, y, size_x, size_y, 1.0, (0, 0, 0))
