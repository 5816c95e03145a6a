"""Interpret sensor_msgs/msg/LaserScan: the nearest obstacle and the free distance on each side, seen from the base."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ros2_mcp.model.errors import BadData
from ros2_mcp.model.meanings import SECTOR_RAD, SECTORS, ScanMeaning
from ros2_mcp.model.poses import Pose, rotated
from ros2_mcp.model.text import counted
from ros2_mcp.world.footprint import Point, beyond
from ros2_mcp_common.language.scans import limits_of, no_bearings

_COVERED = 0.5
"""Least share of a sector that valid beams must cover for its free distance to be reported."""
_TILTED_DEG = 10.0
"""Tilt above which the scan plane meets the floor soon: at a height of 0.3 m in less than 2 m."""
_MOST_BEAMS = 1_000_000
"""More than any scanner has in a turn; a larger message is damaged."""


@dataclass(frozen=True, slots=True)
class ScanPoints:
    """The end points of a scan's beams in its own frame, in metres; `hit` is whether a beam ended at an obstacle.

    Beams without an echo end at the scan's maximum range. `invalid` beams are omitted; `too_close` ones hit an obstacle
    nearer than the minimum range, and are placed at that range.
    """

    xy: NDArray[np.float64]
    hit: NDArray[np.bool_]
    beams: int
    invalid: int
    too_close: int
    range_max_m: float
    step_rad: float

    @property
    def hits(self) -> NDArray[np.float64]:
        """The points of obstacles, n × 2."""
        return self.xy[self.hit]


def scan_points(message: Any) -> ScanPoints:
    """Return the beams of a LaserScan by REP 117.

    +inf (or more than `range_max`) is no echo, -inf too close; NaN and less than `range_min` are invalid. Many drivers
    write 0 for no echo, which is invalid, too.

    Raises:
        BadData: if its angles are not finite or equal for all beams, if they span many turns, or if it has too many
            beams.
    """
    ranges = np.asarray(message.ranges, np.float64)
    if len(ranges) > _MOST_BEAMS:
        raise BadData(f"The scan has {len(ranges)} ranges: no scanner has more than {_MOST_BEAMS}.")
    if why := no_bearings(message):
        hint = "The ranges themselves can be read."
        if "turns" in why:
            hint = "Is angle_increment in degrees? It is in radians."
        raise BadData(f"The scan has no bearings: {why}.", hint)
    angle, step = float(message.angle_min), float(message.angle_increment)
    least, most = limits_of(message)
    echoed = np.isfinite(ranges) & (ranges > 0) & (ranges >= least)
    if math.isinf(most):  # not set: use the farthest echo
        most = float(ranges[echoed].max(initial=0.0))
    too_close = np.isneginf(ranges)
    nothing = np.isposinf(ranges) | (np.isfinite(ranges) & (ranges > most))
    hit = (echoed & ~nothing) | too_close
    metres = np.where(nothing, most, np.where(too_close, least, ranges))
    valid = hit | nothing
    angles = angle + step * np.arange(len(ranges))
    xy = np.stack((metres * np.cos(angles), metres * np.sin(angles)), axis=1)
    return ScanPoints(
        xy=xy[valid],
        hit=hit[valid],
        beams=len(ranges),
        invalid=len(ranges) - int(valid.sum()),
        too_close=int(too_close.sum()),
        range_max_m=most,
        step_rad=abs(step),
    )


def scan_meaning(message: Any, mount: Pose | None = None, base: str = "") -> ScanMeaning:
    """Interpret a scan; `mount` is the pose of its frame in the frame `base`, None if it is not known.

    Raises:
        BadData: as `scan_points`.
    """
    points = scan_points(message)
    pose = mount or Pose()
    seen = moved(points.xy, pose)[:, :2]
    distances, bearings = np.hypot(seen[:, 0], seen[:, 1]), np.arctan2(seen[:, 1], seen[:, 0])
    nearest = int(np.argmin(np.where(points.hit, distances, np.inf))) if points.hit.any() else None
    return ScanMeaning(
        seen_from=message.header.frame_id if mount is None else base,
        is_base=mount is not None,
        nearest_m=None if nearest is None else round(float(distances[nearest]), 3),
        nearest_bearing_deg=None if nearest is None else round(math.degrees(bearings[nearest]), 1),
        nearest_x_m=None if nearest is None else round(float(seen[nearest, 0]), 3),
        nearest_y_m=None if nearest is None else round(float(seen[nearest, 1]), 3),
        free_m=_free(distances, bearings, points.step_rad),
        range_max_m=round(points.range_max_m, 3),
        beams=points.beams,
        invalid=points.invalid,
        note=_note(points, pose, mount is not None),
    )


@dataclass(frozen=True, slots=True)
class Nearest:
    """The obstacle nearest to a footprint: distance in m, and bearing from the base's origin in °, left positive."""

    gap_m: float
    bearing_deg: float


def nearest_to(points: Sequence[Point], message: Any, mount: Pose) -> Nearest | None:
    """Return the point of a scan outside of a robot's footprint that is nearest to it; None if there is none.

    Raises:
        BadData: as `scan_points`.
    """
    hits = moved(scan_points(message).hits, mount)[:, :2]
    gaps = [(beyond(points, x, y), math.degrees(math.atan2(y, x))) for x, y in hits.tolist()]
    return min((Nearest(*gap) for gap in gaps if gap[0] > 0), key=lambda one: one.gap_m, default=None)


def moved(xy: NDArray[np.float64], pose: Pose) -> NDArray[np.float64]:
    """Transform points of a plane (n × 2) or of space (n × 3) from one frame to another; returns n × 3."""
    xyz = np.hstack((xy, np.zeros((len(xy), 1)))) if xy.shape[1] == 2 else xy
    axes = np.array([rotated(pose.rotation, axis) for axis in ((1, 0, 0), (0, 1, 0), (0, 0, 1))])
    return np.asarray(xyz @ axes) + np.array(pose.translation)


def _free(distances: NDArray[np.float64], bearings: NDArray[np.float64], step_rad: float) -> dict[str, float | None]:
    """Return the least distance in each sector, None if too little of it is covered.

    Beams without an echo count with the scanner's range.
    """
    sectors = _sector(bearings)
    free: dict[str, float | None] = {}
    for index, name in enumerate(SECTORS):
        within = distances[sectors == index]
        covered = len(within) * step_rad >= _COVERED * SECTOR_RAD
        free[name] = round(float(within.min()), 3) if covered and len(within) else None
    return free


def _sector(bearings: NDArray[np.float64]) -> NDArray[np.int64]:
    return np.floor(bearings / SECTOR_RAD + 0.5).astype(np.int64) % len(SECTORS)


def _note(points: ScanPoints, pose: Pose, is_base: bool) -> str:
    notes: list[str] = []
    if not is_base:
        notes.append("Measured from the scanner in its own frame, because its mount on the base is unknown.")
    if points.too_close:
        notes.append(f"{counted(points.too_close, 'beam')} hit something nearer than the scanner can measure.")
    if points.invalid * 10 > points.beams:
        notes.append(f"{points.invalid} of {points.beams} beams are invalid.")
    tilt = math.degrees(math.acos(min(1.0, abs(rotated(pose.rotation, (0, 0, 1))[2]))))
    if tilt > _TILTED_DEG:
        notes.append(f"The scan plane is tilted by {tilt:.0f}°: the floor may be among the obstacles.")
    return " ".join(notes)
