"""Interpret point clouds and depth images: the nearest obstacle above the ground, the extent, and the ground."""

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
"""Points that are analysed, evenly spread: an image of 640 × 480 has five times as many, which its surfaces do not
need."""
_AMONG = 5
"""In a dense cloud the fifth nearest point is taken as the nearest obstacle: single points may be sensor noise."""
_DENSE = 500
"""In clouds with fewer points each point counts: points of sparse radars and thinned clouds have no neighbours."""
_BIN_M = 0.05
"""Height of a histogram bin: the thickness of a floor as a depth camera sees it."""
_GROUND_SHARE = 0.1
"""Share of all points that must be at about one height to be the ground."""
_GROUND_WIDE_M = 0.5
"""Least extent of ground in x and y: the top of a box is smaller."""
_ABOVE_M = 0.1
"""Points from this height above the ground are obstacles; lower points are roughness of the ground and sensor noise."""
_TALL_M = 2.0
"""Points higher above the ground, such as a ceiling, are not in the way of most robots."""
_OPTICAL = ("optical", "optical_frame")
"""Endings of the names of optical frames, in which z points forward, by REP 103."""


def cloud_meaning(message: Any, mount: Pose | None = None, base: str = "") -> DepthMeaning:
    """Interpret a PointCloud2; `mount` is the pose of its frame in the frame `base`, None if not known.

    Raises:
        BadData: as `cloud_of`.
    """
    cloud = cloud_of(message)
    return _meaning(_thinned(cloud.xyz), message.header.frame_id, mount, base, (cloud.points, cloud.not_finite))


def depth_meaning(
    message: Any, intrinsics: tuple[float, float, float, float] | None, mount: Pose | None = None, base: str = ""
) -> DepthMeaning | None:
    """Interpret a depth image; None if the image is not a depth image.

    `intrinsics` are fx, fy, cx, cy of its camera info in pixels, None without camera info; `mount` is the pose of the
    optical frame in the frame `base`.

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
    # The points of a depth image are in an optical frame, whatever its name.
    return _meaning(xyz, message.header.frame_id, mount, base, counts, optical=True)


def depth_within(message: Any, box: Sequence[int]) -> tuple[float | None, str]:
    """Return the median depth in m of a box of pixels (left, top, right, bottom, inclusive), and a description.

    The median is None if the image is not a depth image, or the box has no valid depth.

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
    # Rounded once, so that the text and the number show the same value.
    low, median, high = (round(float(value), 3) for value in np.percentile(valid, (2, 50, 98)))
    told = f"depth there {median:.2f} m (from {low:.2f} to {high:.2f} m, {len(valid) / part.size:.0%} of it valid)"
    return median, told


def intrinsics_of(info: Any) -> tuple[float, float, float, float]:
    """Return fx, fy, cx, cy in pixels from a sensor_msgs/msg/CameraInfo: of P, or of K if P is empty."""
    of_rectified = float(info.p[0]), float(info.p[5]), float(info.p[2]), float(info.p[6])
    return of_rectified if of_rectified[0] > 0 else (*(float(info.k[at]) for at in (0, 4, 2, 5)),)  # type: ignore[return-value]


_THIRDS = ("left", "middle", "right")


def _third(name: str, depths: NDArray[np.float64]) -> str:
    nearest = _nearest_of(depths[np.isfinite(depths)])
    return f"{name} {'nothing valid' if nearest is None else f'{nearest:.2f} m'}"


def _nearest_of(distances: NDArray[np.float64]) -> float | None:
    """Return the distance of the nearest obstacle; None if there are no distances."""
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
    """Return x, y and z of the nearest obstacle."""
    if not len(standing):
        return None
    distances = np.hypot(standing[:, 0], standing[:, 1])
    among = min(_AMONG, len(standing)) if len(standing) >= _DENSE else 1
    index = int(np.argpartition(distances, among - 1)[among - 1])
    x, y, z = (float(part) for part in standing[index])
    return x, y, z


def _ground(seen: NDArray[np.float64]) -> tuple[float, float] | None:
    """Return the height of the lowest wide level and its share of the points; None if there is none."""
    heights = seen[:, 2]
    bins = np.floor(heights / _BIN_M).astype(np.int64)
    levels, counts = np.unique(bins, return_counts=True)
    for level in levels[counts >= _GROUND_SHARE / 2 * len(seen)]:
        about = np.abs(bins - level) <= 1  # a level may lie on the boundary of two bins
        if int(about.sum()) < _GROUND_SHARE * len(seen):
            continue
        if (np.ptp(np.quantile(seen[about, :2], (0.05, 0.95), axis=0), axis=0) >= _GROUND_WIDE_M).all():
            return float(np.median(heights[about])), int(about.sum()) / len(seen)
    return None
