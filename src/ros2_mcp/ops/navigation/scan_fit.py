"""Measures how well a laser scan fits the map at the robot's estimated pose."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import Any

from ros2_mcp.model.aside import load
from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.pictures import OCCUPANCY_GRID
from ros2_mcp.model.text import named
from ros2_mcp.ops.navigation.targets import MAP_FRAME
from ros2_mcp.ops.pictures.next_message import next_message
from ros2_mcp.ops.results.results import silent
from ros2_mcp.ops.sources.live import Live
from ros2_mcp.robot import Robot

_SCAN = "sensor_msgs/msg/LaserScan"
_MAP_S, _SCAN_S = 2.0, 1.5
"""A map is latched; the slowest scanners scan five times a second."""
_LEAST_HITS = 20
"""With fewer beams that hit something a share means nothing."""


@dataclass(frozen=True, slots=True)
class ScanFit:
    """`share` of the beams that end within 0.15 m of an occupied cell of the map, of `beams` that end on it."""

    share: float
    beams: int
    scan_topic: str
    map_topic: str

    def __str__(self) -> str:
        return f"{self.share:.0%} of {self.beams} beams of {named(self.scan_topic)} fit {named(self.map_topic)}"


async def scan_fit(robot: Robot) -> ScanFit | str:
    """Return the fit now, or a sentence on why it is unknown. Raises no `RobotError`."""
    await load("ros2_mcp.world.scans", "ros2_mcp.world.map_fit")  # with numpy: not before it is needed
    from ros2_mcp.ops.space.frames import pose_in
    from ros2_mcp.world.map_fit import share_that_fits
    from ros2_mcp.world.occupancy import OccupancyGrid
    from ros2_mcp.world.scans import moved, scan_points

    try:
        rows = [row for row in await robot.graph.topics() if row.publishers]
        maps = sorted(row.name for row in rows if OCCUPANCY_GRID in row.types and "costmap" not in row.name)
        scans = sorted(row.name for row in rows if _SCAN in row.types)
        if not maps or not scans:
            return "no map is published" if not maps else "no laser scan is published"
        maps.sort(key=lambda name: (not name.endswith("/map"), len(name)))
        grid = OccupancyGrid((await next_message(Live(robot).lasting(_MAP_S), maps[0], OCCUPANCY_GRID, silent)).message)
        scan: Any = (await next_message(Live(robot).lasting(_SCAN_S), scans[0], _SCAN, silent)).message
        located = await pose_in(Live(robot), grid.frame_id or MAP_FRAME, scan.header.frame_id)
        hits = moved(scan_points(scan).hits, located.pose)[:, :2]
    except RobotError as error:
        return error.message.rstrip(".")
    if len(hits) < _LEAST_HITS:
        return f"only {len(hits)} beams of {named(scans[0])} end at something"
    share, beams = await asyncio.to_thread(share_that_fits, grid, hits.tolist())
    return ScanFit(round(share, 3), beams, scans[0], maps[0])
