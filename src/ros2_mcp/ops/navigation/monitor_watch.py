"""Looks for what stands in the polygon by which the collision monitor holds, slows or limits a robot that navigates."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from time import monotonic
from typing import Any

from ros2_mcp.model.aside import load
from ros2_mcp.model.errors import RobotError
from ros2_mcp.ops.navigation.checks.collision_monitor import (
    Near,
    base_of_monitor,
    near_in,
    sources_of,
    stop_polygons,
)
from ros2_mcp.ops.navigation.drive_watch import DriveWatch
from ros2_mcp.ops.navigation.evidence import SCAN
from ros2_mcp.ops.navigation.readers import declared_by, values_of
from ros2_mcp.ops.pictures.next_message import next_message
from ros2_mcp.ops.results.results import silent
from ros2_mcp.ops.sources.live import Live
from ros2_mcp.ops.space.frames import pose_in
from ros2_mcp.robot import Robot

_EVERY_S = 0.5
_SCAN_S = 1.0
"""The slowest scanners scan five times a second."""


async def follow_monitor(robot: Robot, node: str, watch: DriveWatch) -> None:
    """Tell `watch` the nearest point in the polygon by which the monitor of this name acts, and, while the monitor has
    published nothing and the robot does not move although it is commanded, which of its stop polygons is not free. Runs
    until it is cancelled; raises no `RobotError`."""
    values: Mapping[str, Any] = {}
    while True:
        await asyncio.sleep(_EVERY_S)
        polygon, is_unknown = watch.held_by, watch.is_monitor_unknown(monotonic())
        if not polygon and not is_unknown:
            continue
        try:
            values = values or await values_of(robot, node, await declared_by(robot, node))
            hits = await _hits(robot, node, values)
        except RobotError:  # such as a source that is silent, or a transform that is not there
            watch.near(polygon, None)
            continue
        if is_unknown:
            watch.occupied(*_occupied(values, hits), monotonic())
        else:
            watch.near(polygon, next(iter(near_in(values, polygon, hits)), None))


def _occupied(values: Mapping[str, Any], hits: Sequence[tuple[float, float]]) -> tuple[str, Near | None]:
    """Return the first stop polygon with enough points in it, and the nearest of them; "" and None if all are free."""
    for polygon, least in stop_polygons(values):
        if len(near := near_in(values, polygon, hits)) >= least:
            return polygon, near[0]
    return "", None


async def _hits(robot: Robot, node: str, values: Mapping[str, Any]) -> list[tuple[float, float]]:
    """Return what the monitor's scans hit, as x and y in the frame of its polygons, in m."""
    await load("ros2_mcp.world.scans")  # with numpy: not before it is needed
    from ros2_mcp.world.scans import moved, scan_points

    hits: list[tuple[float, float]] = []
    for topic in sources_of(node, values).values():
        if SCAN not in (await robot.graph.endpoints(topic)).types:
            continue
        scan: Any = (await next_message(Live(robot).lasting(_SCAN_S), topic, SCAN, silent)).message
        mount = await pose_in(Live(robot), base_of_monitor(values), str(scan.header.frame_id).lstrip("/"))
        hits += [(float(x), float(y)) for x, y in moved(scan_points(scan).hits, mount.pose)[:, :2].tolist()]
    return hits
