"""Renders the robot's camera: walls, floor and obstacles, drawn column by column. Pure numpy, no ROS."""

# pyright: basic
from __future__ import annotations

import math

import numpy as np

from .world import WALL_HEIGHT

WIDTH, HEIGHT = 320, 240
FIELD_OF_VIEW = math.radians(70)
EYE_HEIGHT = 0.35
FAR = 20.0

FOCAL = WIDTH / 2 / math.tan(FIELD_OF_VIEW / 2)  # in pixels
CENTER_X, CENTER_Y = (WIDTH - 1) / 2, (HEIGHT - 1) / 2

# South, east, north and west sides of the room, then the same for each inner wall.
_ROOM_COLORS = ((196, 164, 120), (126, 158, 186), (150, 172, 128), (182, 138, 150))
_INNER_COLORS = ((216, 208, 190), (226, 216, 196), (216, 208, 190), (206, 196, 178))
_FLOOR = np.array([[118, 112, 106], [148, 142, 134]], np.float32)
_SKY_TOP, _SKY_LOW = np.array([92, 140, 205], np.float32), np.array([204, 224, 242], np.float32)
_LIGHT = math.radians(200)  # the direction the light comes from

_BEARINGS = np.arctan((CENTER_X - np.arange(WIDTH)) / FOCAL)
_ROWS = np.arange(HEIGHT, dtype=np.float32)[:, np.newaxis]
_HORIZON = math.ceil(CENTER_Y)
_FLOOR_DEPTHS = (EYE_HEIGHT * FOCAL / (_ROWS[_HORIZON:] - CENTER_Y)).astype(np.float32)
_SKY_SHARE = (_ROWS[:_HORIZON] / _HORIZON)[:, :, np.newaxis]
_SKY = np.broadcast_to(_SKY_TOP + (_SKY_LOW - _SKY_TOP) * _SKY_SHARE, (_HORIZON, WIDTH, 3))


def render(world, pose, brightness=1.0, rng=None):
    """Return the camera's picture, uint8 (HEIGHT, WIDTH, 3) in RGB, with sensor noise if `rng` is given."""
    picture = np.empty((HEIGHT, WIDTH, 3), np.float32)
    picture[:_HORIZON] = _SKY
    picture[_HORIZON:] = _floor(pose)
    _draw_walls(picture, world, pose)
    for _, obstacle, depths, normals in _visible(world, pose):
        faded = _fade(np.where(np.isfinite(depths), depths, FAR))
        shade = (0.72 + 0.28 * np.cos(normals - _LIGHT)) * faded
        _draw(picture, depths, obstacle.height, np.asarray(obstacle.color, np.float32) * shade[:, np.newaxis])
    if rng is not None:
        picture += rng.standard_normal((HEIGHT, WIDTH, 1), np.float32) * 2.0
    return np.clip(picture * brightness, 0, 255).astype(np.uint8)


def render_depth(world, pose):
    """Return the depth picture, float32 (HEIGHT, WIDTH): m along the optical axis, infinite for the sky."""
    depth = np.full((HEIGHT, WIDTH), np.inf, np.float32)
    depth[_HORIZON:] = _FLOOR_DEPTHS
    distances, _, _ = world.cast_walls(pose.x, pose.y, pose.yaw + _BEARINGS)
    walls = distances * np.cos(_BEARINGS)
    _draw(depth, walls, WALL_HEIGHT, walls)
    for _, obstacle, depths, _ in _visible(world, pose):
        _draw(depth, depths, obstacle.height, depths)
    return depth


def _visible(world, pose):
    """Return (distance, obstacle, depth per column, normals) of the obstacles in view, the farthest first."""
    angles = pose.yaw + _BEARINGS
    walls = world.cast_walls(pose.x, pose.y, angles)[0]
    seen = []
    for obstacle in world.obstacles:
        distances, normals = obstacle.cast(pose.x, pose.y, angles)
        distances = np.where(distances < walls, distances, np.inf)
        if np.isfinite(distances).any():
            seen.append((float(distances.min()), obstacle, distances * np.cos(_BEARINGS), normals))
    return sorted(seen, key=lambda item: -item[0])


def _floor(pose):
    """Return a chessboard of half-metre tiles that fades with distance, float32 (rows, WIDTH, 3)."""
    left = (CENTER_X - np.arange(WIDTH, dtype=np.float32)) / FOCAL
    forward_x, forward_y = math.cos(pose.yaw), math.sin(pose.yaw)
    x = pose.x + _FLOOR_DEPTHS * (forward_x - left * forward_y).astype(np.float32)
    y = pose.y + _FLOOR_DEPTHS * (forward_y + left * forward_x).astype(np.float32)
    tiles = (np.floor(x * 2) + np.floor(y * 2)).astype(np.int32) & 1
    return _FLOOR[tiles] * _fade(_FLOOR_DEPTHS)[:, :, np.newaxis]


def _draw_walls(picture, world, pose):
    distances, sides, along = world.cast_walls(pose.x, pose.y, pose.yaw + _BEARINGS)
    depths = distances * np.cos(_BEARINGS)
    palette = np.array(_ROOM_COLORS + _INNER_COLORS * ((len(world.walls) - 4) // 4), np.float32)
    panel = 1.0 - 0.07 * (np.floor(along * 2).astype(np.int32) & 1) - 0.25 * (along * 2 % 1 < 0.04)
    colors = palette[sides] * (panel * _fade(depths))[:, np.newaxis]
    _draw(picture, depths, WALL_HEIGHT, colors)
    _draw(picture, depths, 0.08, colors * 0.55)


def _draw(picture, depths, height, values):
    """Fill each column from the floor up to `height` m, at its depth (n,), with its value (n,) or colour (n, 3)."""
    safe = np.where(np.isfinite(depths), np.maximum(depths, 0.02), FAR)
    bottom = CENTER_Y + EYE_HEIGHT * FOCAL / safe
    top = CENTER_Y - (height - EYE_HEIGHT) * FOCAL / safe
    rows, columns = np.nonzero((top <= _ROWS) & (bottom >= _ROWS) & np.isfinite(depths))
    picture[rows, columns] = values[columns]


def _fade(depths):
    return 0.45 + 0.55 * np.exp(-np.asarray(depths) / 7.0)
