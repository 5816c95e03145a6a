"""Point clouds and depth images as what they mean: the nearest thing above the ground, the extent, the ground."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ros2_mcp.model.meanings import DepthMeaning
from ros2_mcp.model.poses import Pose
from ros2_mcp.pictures.images import depth_of
from ros2_mcp.world.clouds import cloud_of
from ros2_mcp.world.scans import moved

_MOST_POINTS = 60_000
"""Looked at, evenly spread: a picture of 640 × 480 has five times as many, and its surfaces do not show it."""
_AMONG = 5
"""The nearest thing is told by the fifth nearest point of a dense cloud: single points may be noise of the sensor."""
_DENSE = 500
"""Of fewer points each one counts: sparse radars and thinned clouds have no neighbours."""
_BIN_M = 0.05
"""Heights are counted in steps of that: a floor seen by a depth camera is as thick."""
_GROUND_SHARE = 0.1
"""Of the points, that lie at about one height in what is taken for ground."""
_GROUND_WIDE_M = 0.5
"""How far ground goes at least in x and y: the top of a box is smaller."""
_ABOVE_M = 0.1
"""From this height above the ground on something is an obstacle: less is the roughness of the ground and of sensors."""
_TALL_M = 2.0
"""What is higher above the ground does not stand in the way of most robots, such as a ceiling."""
_OPTICAL = ("optical", "optical_frame")
"""How frames are called in which z looks forward, by REP 103."""


def cloud_meaning(message: Any, mount: Pose | None = None, base: str = "") -> DepthMeaning:
    """What a PointCloud2 says; `mount` is the pose of its frame in the frame `base`, None where not known.

    Raises:
        BadData: as `cloud_of`.
    """
    cloud = cloud_of(message)
    return _meaning(_thinned(cloud.xyz), message.header.frame_id, mount, base, (cloud.points, cloud.not_finite))


def depth_meaning(
    message: Any, intrinsics: tuple[float, float, float, float] | None, mount: Pose | None = None, base: str = ""
) -> DepthMeaning | None:
    """What a depth image says; None for an image that is none.

    `intrinsics` are fx, fy, cx, cy of its camera info in pixels, None where there is none; `mount` as for a cloud, of
    the optical frame.

    Raises:
        BadData: as `depth_of`.
    """
    depths = depth_of(message)
    if depths is None:
        return None
    valid = np.isfinite(depths)
    counts = depths.size, int(depths.size - valid.sum())
    if intrinsics is None or not (intrinsics[0] > 0 and intrinsics[1] > 0):
        nearest = _nearest_of(depths[valid])
        thirds = ", ".join(
            _third(name, part) for name, part in zip(_THIRDS, np.array_split(depths, 3, axis=1), strict=True)
        )
        note = (
            f"By thirds of the picture: {thirds}. Without camera info, the floor is included and positions are unknown."
        )
        frame, metres = message.header.frame_id, None if nearest is None else round(nearest, 3)
        return DepthMeaning(
            seen_from=frame, is_base=False, nearest_m=metres, points=counts[0], invalid=counts[1], note=note
        )
    fx, fy, cx, cy = intrinsics
    step = max(1, math.isqrt(depths.size // _MOST_POINTS))
    rows, columns = np.nonzero(valid[::step, ::step])
    z = depths[::step, ::step][rows, columns]
    xyz = np.stack(((columns * step - cx) * z / fx, (rows * step - cy) * z / fy, z), axis=1)
    # The pixels of a depth image are in an optical frame, whatever it is called.
    return _meaning(xyz, message.header.frame_id, mount, base, counts, optical=True)


def depth_within(message: Any, box: Sequence[int]) -> tuple[float | None, str]:
    """The median depth in m of a box of pixels (left, top, right, bottom, these within), None where there is none; and
    what there is, in words.

    Raises:
        BadData: as `depth_of`.
    """
    depths = depth_of(message)
    if depths is None:
        return None, ""
    left, top, right, bottom = box
    part = depths[top : bottom + 1, left : right + 1]
    valid = part[np.isfinite(part)]
    if not len(valid):
        return None, "no valid depth there"
    # To a millimetre, once: the words and the number are of the same value.
    low, median, high = (round(float(value), 3) for value in np.percentile(valid, (2, 50, 98)))
    told = f"depth there {median:.2f} m (from {low:.2f} to {high:.2f} m, {len(valid) / part.size:.0%} of it valid)"
    return median, told


def intrinsics_of(info: Any) -> tuple[float, float, float, float]:
    """fx, fy, cx, cy of a sensor_msgs/msg/CameraInfo: of its projection, or where that is empty of its camera."""
    of_rectified = float(info.p[0]), float(info.p[5]), float(info.p[2]), float(info.p[6])
    return of_rectified if of_rectified[0] > 0 else (*(float(info.k[at]) for at in (0, 4, 2, 5)),)  # type: ignore[return-value]


_THIRDS = ("left", "middle", "right")


def _third(name: str, depths: NDArray[np.float64]) -> str:
    nearest = _nearest_of(depths[np.isfinite(depths)])
    return f"{name} {'nothing valid' if nearest is None else f'{nearest:.2f} m'}"


def _nearest_of(distances: NDArray[np.float64]) -> float | None:
    """The distance at which the nearest thing is; None of no distances."""
    if not len(distances):
        return None
    among = min(_AMONG, len(distances)) if len(distances) >= _DENSE else 1
    return float(np.partition(distances, among - 1)[among - 1])


def _thinned(xyz: NDArray[np.float64]) -> NDArray[np.float64]:
    return xyz[:: max(1, -(-len(xyz) // _MOST_POINTS))]


def _meaning(
    xyz: NDArray[np.float64],
    frame: str,
    mount: Pose | None,
    base: str,
    counts: tuple[int, int],
    *,
    optical: bool = False,
) -> DepthMeaning:
    notes: list[str] = []
    seen = xyz
    if mount is not None:
        seen = moved(xyz, mount)
    else:
        notes.append("Measured from the sensor, because its mount on the base is unknown.")
        if optical or frame.endswith(_OPTICAL):
            seen = np.stack((xyz[:, 2], -xyz[:, 0], -xyz[:, 1]), axis=1)
    points, invalid = counts
    if not len(seen):
        notes = ["No point has a valid position."]
        return DepthMeaning(
            seen_from=base or frame, is_base=mount is not None, points=points, invalid=invalid, note=notes[0]
        )
    low, high = np.quantile(seen, 0.01, axis=0), np.quantile(seen, 0.99, axis=0)
    ground = _ground(seen)
    floor = -math.inf if ground is None else ground[0] + _ABOVE_M
    ceiling = math.inf if ground is None else ground[0] + _TALL_M
    standing = seen[(seen[:, 2] > floor) & (seen[:, 2] < ceiling)]
    near = _nearest_point(standing)
    return DepthMeaning(
        seen_from=frame if mount is None else base,
        is_base=mount is not None,
        nearest_m=None if near is None else round(math.hypot(near[0], near[1]), 3),
        nearest_bearing_deg=None if near is None else round(math.degrees(math.atan2(near[1], near[0])), 1),
        nearest_x_m=None if near is None else round(near[0], 3),
        nearest_y_m=None if near is None else round(near[1], 3),
        nearest_z_m=None if near is None else round(near[2], 3),
        ground_z_m=None if ground is None else round(ground[0], 3),
        ground_share=None if ground is None else round(ground[1], 3),
        x_min_m=round(float(low[0]), 3),
        x_max_m=round(float(high[0]), 3),
        y_min_m=round(float(low[1]), 3),
        y_max_m=round(float(high[1]), 3),
        z_min_m=round(float(low[2]), 3),
        z_max_m=round(float(high[2]), 3),
        points=points,
        invalid=invalid,
        note=" ".join(notes),
    )


def _nearest_point(standing: NDArray[np.float64]) -> tuple[float, float, float] | None:
    """x, y and z of the nearest thing."""
    if not len(standing):
        return None
    distances = np.hypot(standing[:, 0], standing[:, 1])
    among = min(_AMONG, len(standing)) if len(standing) >= _DENSE else 1
    index = int(np.argpartition(distances, among - 1)[among - 1])
    x, y, z = (float(part) for part in standing[index])
    return x, y, z


def _ground(seen: NDArray[np.float64]) -> tuple[float, float] | None:
    """Height and share of points of the lowest wide level; None where there is none."""
    heights = seen[:, 2]
    bins = np.floor(heights / _BIN_M).astype(np.int64)
    levels, counts = np.unique(bins, return_counts=True)
    for level in levels[counts >= _GROUND_SHARE / 2 * len(seen)]:
        about = np.abs(bins - level) <= 1  # a level may lie on the edge of two bins
        if int(about.sum()) < _GROUND_SHARE * len(seen):
            continue
        if (np.ptp(np.quantile(seen[about, :2], (0.05, 0.95), axis=0), axis=0) >= _GROUND_WIDE_M).all():
            return float(np.median(heights[about])), int(about.sum()) / len(seen)
    return None
