"""The simulated world: a walled room with an inner wall, a doorway and obstacles; ray casting and occupancy.

Metres and radians; x to the right, y up; the robot starts at (0, 0), facing along x. Pure numpy, no ROS.
"""

# pyright: basic
from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

ROOM = (-2.0, -3.0, 6.0, 3.0)  # x_min, y_min, x_max, y_max
WALL_HEIGHT = 1.2

FREE, OCCUPIED, UNKNOWN = 0, 100, -1


@dataclass(frozen=True)
class Box:
    """An axis-aligned box on the floor; (`x`, `y`) is its centre in m."""

    name: str
    x: float
    y: float
    size_x: float
    size_y: float
    height: float
    color: tuple[int, int, int]

    def edges(self):
        """Return the four sides as an array (4, 4) of x1, y1, x2, y2, counter-clockwise."""
        half_x, half_y = self.size_x / 2, self.size_y / 2
        return rectangle(self.x - half_x, self.y - half_y, self.x + half_x, self.y + half_y)

    def distance(self, x, y):
        """Return the distance from points to the box, in m; 0 inside."""
        outside_x = np.maximum(np.abs(np.asarray(x) - self.x) - self.size_x / 2, 0.0)
        outside_y = np.maximum(np.abs(np.asarray(y) - self.y) - self.size_y / 2, 0.0)
        return np.hypot(outside_x, outside_y)

    def cast(self, x, y, angles):
        """Return the distance (n,) along each ray, infinite where it misses, and the angle (n,) of the surface normal
        there."""
        distances, side, _ = cast_segments(x, y, angles, self.edges())
        return distances, np.array([-0.5, 0.0, 0.5, 1.0])[side] * math.pi


@dataclass(frozen=True)
class Pillar:
    """An upright cylinder on the floor."""

    name: str
    x: float
    y: float
    radius: float
    height: float
    color: tuple[int, int, int]

    def distance(self, x, y):
        """Return the distance from points to the pillar, in m; 0 inside."""
        return np.maximum(np.hypot(np.asarray(x) - self.x, np.asarray(y) - self.y) - self.radius, 0.0)

    def cast(self, x, y, angles):
        """Return the distance (n,) along each ray, infinite where it misses, and the angle (n,) of the surface normal
        there."""
        to_x, to_y = self.x - x, self.y - y
        along = to_x * np.cos(angles) + to_y * np.sin(angles)
        half_chord_squared = self.radius**2 - (to_x**2 + to_y**2 - along**2)
        near = along - np.sqrt(np.maximum(half_chord_squared, 0.0))
        distances = np.where((half_chord_squared > 0) & (near > 0), near, np.inf)
        reach = np.where(np.isfinite(distances), distances, 0.0)
        hit_x, hit_y = x + reach * np.cos(angles), y + reach * np.sin(angles)
        return distances, np.arctan2(hit_y - self.y, hit_x - self.x)


INNER_WALLS = (
    Box("inner wall south", 2.5, -1.1, 0.1, 3.8, WALL_HEIGHT, (0, 0, 0)),
    Box("inner wall north", 2.5, 2.4, 0.1, 1.2, WALL_HEIGHT, (0, 0, 0)),
)
"""The inner wall with its doorway: x = 2.5, y from 0.8 to 1.8."""

OBSTACLES = (
    Pillar("red pillar", 1.6, -1.0, 0.22, 0.9, (205, 52, 44)),
    Box("yellow box", -1.2, 2.0, 0.6, 0.6, 0.5, (233, 184, 36)),
    Box("blue box", 4.2, -0.9, 0.8, 0.6, 0.6, (44, 92, 190)),
    Pillar("green pillar", 4.6, 1.7, 0.2, 0.8, (52, 150, 70)),
)


class World:
    """The room and its obstacles. `obstacles` can change while the robot drives; the walls and the map do not."""

    def __init__(self, obstacles=OBSTACLES):
        self.obstacles = list(obstacles)
        self.mapped = (*INNER_WALLS, *self.obstacles)
        self.walls = np.vstack([rectangle(*ROOM), *(wall.edges() for wall in INNER_WALLS)])

    def place(self, obstacle):
        """Add an obstacle, or move the one of the same name; the map does not change."""
        self.obstacles = [other for other in self.obstacles if other.name != obstacle.name]
        self.obstacles.append(obstacle)

    def cast(self, x, y, angles):
        """Return the distance (n,) in m from a point along each ray to the first hit; infinite without a hit."""
        nearest, _, _ = self.cast_walls(x, y, angles)
        for obstacle in self.obstacles:
            nearest = np.minimum(nearest, obstacle.cast(x, y, angles)[0])
        return nearest

    def cast_walls(self, x, y, angles):
        """Cast rays to the walls only; return distance, index of the wall side, and position along that side (m), each
        (n,)."""
        return cast_segments(x, y, angles, self.walls)

    def clearance(self, x, y):
        """Return the distance in m from a point to the nearest wall or obstacle; negative outside the room."""
        x_min, y_min, x_max, y_max = ROOM
        to_room = min(x - x_min, x_max - x, y - y_min, y_max - y)
        return float(min(to_room, *(solid.distance(x, y) for solid in (*INNER_WALLS, *self.obstacles))))

    def occupancy(self, resolution=0.05, margin=0.1):
        """Return the robot's map: int8 (rows, columns), row 0 at the smallest y; and its origin (x, y) in m."""
        x_min, y_min, x_max, y_max = ROOM
        columns = round((x_max - x_min + 2 * margin) / resolution)
        rows = round((y_max - y_min + 2 * margin) / resolution)
        x = x_min - margin + (np.arange(columns) + 0.5) * resolution
        y = (y_min - margin + (np.arange(rows) + 0.5) * resolution)[:, np.newaxis]
        outside = np.maximum(np.maximum(x_min - x, x - x_max), np.maximum(y_min - y, y - y_max))
        solid = np.min([thing.distance(x, y) for thing in self.mapped], axis=0) <= resolution / 4
        cells = np.where(solid | (outside > 0), OCCUPIED, FREE).astype(np.int8)
        cells[outside > resolution] = UNKNOWN
        return cells, (x_min - margin, y_min - margin)


def rectangle(x_min, y_min, x_max, y_max):
    """Return the sides (4, 4) of an axis-aligned rectangle: south, east, north, west."""
    corners = [(x_min, y_min), (x_max, y_min), (x_max, y_max), (x_min, y_max)]
    return np.array([[*corners[side - 1], *corners[side]] for side in (1, 2, 3, 0)])


def cast_segments(x, y, angles, segments):
    """Find where rays from one point first hit segments (m, 4).

    Returns three arrays (n,): the distance (infinite where a ray meets none), the segment's index, and the
    distance of the meeting point from the segment's first end.
    """
    ray_x, ray_y = np.cos(angles)[:, np.newaxis], np.sin(angles)[:, np.newaxis]
    start_x, start_y = segments[:, 0] - x, segments[:, 1] - y
    side_x, side_y = segments[:, 2] - segments[:, 0], segments[:, 3] - segments[:, 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        cross = ray_x * side_y - ray_y * side_x
        distance = (start_x * side_y - start_y * side_x) / cross
        share = (start_x * ray_y - start_y * ray_x) / cross
        distance = np.where((distance > 0) & (share >= 0) & (share <= 1), distance, np.inf)
    index = np.argmin(distance, axis=1)
    rows = np.arange(len(index))
    return distance[rows, index], index, share[rows, index] * np.hypot(side_x, side_y)[index]
