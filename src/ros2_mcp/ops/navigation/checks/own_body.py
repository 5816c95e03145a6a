"""A lidar that sees the robot itself: parts of the robot become obstacles, and its own position is occupied."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from typing import Any, cast

from ros2_mcp.model.text import named
from ros2_mcp.ops.navigation.checks.check import SENSORS, NavCheck
from ros2_mcp.ops.navigation.evidence import SCAN, Heard, NavEvidence, NavFinding
from ros2_mcp_common.policy.polygons import is_inside

_LEAST_SCANS, _LEAST_BEAMS = 3, 3
_GAP, _MOST_SECTORS = 5, 4
"""Beams that a sector may lack: a post is not seen by each of them."""
_INSIDE = 0.98
"""Share of the radius within which a beam must end: at the very edge it may hit something that touches the robot."""


def _find(evidence: NavEvidence) -> Iterator[NavFinding]:
    frames = evidence.frames
    corners, radius_m = outline_of(evidence)
    if frames is None or not (corners or radius_m):
        return
    for one in evidence.of(SCAN):
        if len(one.messages) < _LEAST_SCANS:
            continue
        mount = frames.tree.newest(frames.tree.base, one.frame_id) if frames.tree.base else None
        if mount is None:
            continue
        x, y, _ = mount.pose.translation
        found = _beams(one, corners, radius_m, x, y, mount.pose.yaw_rad)
        if len(found) < _LEAST_BEAMS:
            continue
        message = one.messages[-1][1]
        ranges = [float(message.ranges[beam]) for beam in found]
        yield NavFinding(
            rank="stops everything",
            subject=one.topic,
            cause=f"The lidar sees the robot itself: {len(found)} beams at {_sectors(message, found)} of "
            f"{named(one.topic)} always end inside its outline.",
            proof=f"{len(found)} beams read {min(ranges):.2f} to {max(ranges):.2f} m in {len(one.messages)} scans; "
            f"{_outline_in_words(corners, radius_m)}.",
            remedy="Filter these angles out (laser_filters), raise range_min above that, or correct the outline.",
            covers=evidence.of_role("collision_monitor"),
        )


def outline_of(evidence: NavEvidence) -> tuple[Sequence[tuple[float, float]], float]:
    """Return the robot's footprint as the costmaps have it: its corners in m, or none and a radius in m."""
    for node in evidence.of_role("local_costmap", "global_costmap"):
        footprint = evidence.value(node, "footprint")
        if isinstance(footprint, str) and len(footprint) > 4:
            try:
                return [(float(x), float(y)) for x, y in cast("Sequence[Any]", json.loads(footprint))], 0.0
            except (TypeError, ValueError):
                continue
        radius = evidence.value(node, "robot_radius")
        if isinstance(radius, (int, float)) and not isinstance(radius, bool):
            return (), float(radius)
    return (), 0.0


def _beams(
    heard: Heard, corners: Sequence[tuple[float, float]], radius_m: float, x: float, y: float, yaw_rad: float
) -> list[int]:
    """Return the indices of the beams that end inside the footprint in every scan."""
    always: set[int] | None = None
    for _, message, _ in heard.messages:
        inside = set[int]()
        for beam, value in enumerate(message.ranges):
            away = float(value)
            if not (math.isfinite(away) and max(float(message.range_min), 0.0) <= away and away > 0):
                continue
            if away > 3.0:
                continue
            angle = float(message.angle_min) + beam * float(message.angle_increment) + yaw_rad
            end_x, end_y = x + away * math.cos(angle), y + away * math.sin(angle)
            if is_inside(end_x, end_y, corners) if corners else math.hypot(end_x, end_y) < _INSIDE * radius_m:
                inside.add(beam)
        always = inside if always is None else always & inside
        if not always:
            return []
    return sorted(always or ())


def _sectors(message: Any, beams: Sequence[int]) -> str:
    """Where these beams are, by sector, from the first to the last; a sector that goes over ±180° is one sector."""
    count, step = len(message.ranges), float(message.angle_increment)
    groups: list[list[int]] = []
    for beam in beams:
        if groups and beam - groups[-1][-1] <= _GAP:
            groups[-1].append(beam)
        else:
            groups.append([beam])
    is_round = abs(step) * count > 2 * math.pi - 1.5 * abs(step)
    if is_round and len(groups) > 1 and groups[0][0] + count - groups[-1][-1] <= _GAP:
        groups[0] = [*groups.pop(), *groups[0]]

    def degrees(beam: int) -> str:
        angle = math.degrees(float(message.angle_min) + beam * step)
        return f"{angle - 360 * math.floor((angle + 180.5) / 360):.0f}"

    sectors = [f"{degrees(group[0])} to {degrees(group[-1])}°" for group in groups]
    more = f" and {len(sectors) - _MOST_SECTORS} more" if len(sectors) > _MOST_SECTORS else ""
    return f"{', '.join(sectors[:_MOST_SECTORS])}{more}"


def _outline_in_words(corners: Sequence[tuple[float, float]], radius_m: float) -> str:
    if not corners:
        return f"its radius is {radius_m:g} m"
    xs, ys = [x for x, _ in corners], [y for _, y in corners]
    return f"its outline is {max(xs) - min(xs):.2f} × {max(ys) - min(ys):.2f} m"


CHECK = NavCheck(("frames", "heard", "parameters"), _find, SENSORS)
