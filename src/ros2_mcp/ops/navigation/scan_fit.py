"""Measures how well a laser scan fits the map, at the robot's estimated pose or at any other."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ros2_mcp.model.aside import load
from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.pictures import OCCUPANCY_GRID
from ros2_mcp.model.text import named
from ros2_mcp.ops.navigation.targets import MAP_FRAME
from ros2_mcp.ops.pictures.next_message import next_message
from ros2_mcp.ops.results.results import silent
from ros2_mcp.ops.sources.live import Live
from ros2_mcp.robot import Robot

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ros2_mcp.world.occupancy import OccupancyGrid

_SCAN = "sensor_msgs/msg/LaserScan"
_MAP_S, _SCAN_S = 2.0, 1.5
"""A map is latched; the slowest scanners scan five times a second."""
_LEAST_HITS = 20
"""With fewer beams that hit something a share means nothing."""


@dataclass(frozen=True, slots=True)
class ScanFit:
    """How well a scan fits the map: `hits` beams end at something, `beams` of these end on the map, and the `share` of
    `beams` ends within 0.15 m of an occupied cell.
    """

    share: float
    beams: int
    hits: int
    scan_topic: str
    map_topic: str

    @property
    def of_all(self) -> float:
        """The share of fitting beams if beams that leave the map count as not fitting, as for a doubtful pose."""
        return self.share * self.beams / self.hits if self.share else 0.0

    def __str__(self) -> str:
        off = f", and {self.hits - self.beams} leave it" if self.beams < self.hits else ""
        return f"{self.share:.0%} of {self.beams} beams of {named(self.scan_topic)} fit {named(self.map_topic)}{off}"


@dataclass(frozen=True, slots=True)
class ScanOnMap:
    """A map, and the ends of a scan's beams, n × 2 in m, in the frame `base` of the robot's body."""

    grid: OccupancyGrid
    hits: NDArray[Any]
    base: str
    scan_topic: str
    map_topic: str

    async def fit_at(self, x_m: float, y_m: float, yaw_rad: float) -> ScanFit:
        """Return the fit if the robot were at a pose in the map."""
        from ros2_mcp.world.map_fit import share_that_fits

        share, beams = await asyncio.to_thread(share_that_fits, self.grid, self.hits.tolist(), x_m, y_m, yaw_rad)
        return ScanFit(round(share, 3), beams, len(self.hits), self.scan_topic, self.map_topic)


async def scan_fit(robot: Robot) -> ScanFit | str:
    """Return the fit now, or a sentence on why it is unknown. Raises no `RobotError`."""
    await load("ros2_mcp.world.scans", "ros2_mcp.world.map_fit")  # with numpy: not before it is needed
    from ros2_mcp.ops.space.frames import pose_in
    from ros2_mcp.world.scans import moved

    try:
        read = await _read(robot)
        if isinstance(read, str):
            return read
        located = await pose_in(Live(robot), read.grid.frame_id or MAP_FRAME, read.frame)
    except RobotError as error:
        return error.message.rstrip(".")
    hits = moved(read.hits, located.pose)[:, :2]
    return await ScanOnMap(read.grid, hits, "", read.scan_topic, read.map_topic).fit_at(0.0, 0.0, 0.0)


async def scan_on_map(robot: Robot, known: ScanOnMap | None = None) -> ScanOnMap | str:
    """Return the map and a current scan, to test poses other than the estimated one; or a sentence on what is missing.
    The map of `known` is not read again. Raises no `RobotError`.
    """
    await load("ros2_mcp.world.scans", "ros2_mcp.world.map_fit")  # with numpy: not before it is needed
    from ros2_mcp.ops.space.frames import frames_of
    from ros2_mcp.world.no_transform import why_none
    from ros2_mcp.world.scans import moved

    try:
        read = await _read(robot, known)
        if isinstance(read, str):
            return read
        frame = read.frame.lstrip("/")
        tree = await frames_of(
            Live(robot), until=lambda tree: bool(tree.base) and tree.find(tree.base, frame) is not None
        )
        base = tree.base or "base_link"
        located = tree.find(base, frame)
        if located is None:
            return str(why_none(tree, base, frame, None)).rstrip(".")
    except RobotError as error:
        return error.message.rstrip(".")
    hits = moved(read.hits, located.pose)[:, :2]
    return ScanOnMap(read.grid, hits, base, read.scan_topic, read.map_topic)


@dataclass(frozen=True, slots=True)
class _Read:
    """A map and a scan; `hits` in the scanner's own `frame`."""

    grid: OccupancyGrid
    hits: NDArray[Any]
    frame: str
    scan_topic: str
    map_topic: str


async def _read(robot: Robot, known: ScanOnMap | None = None) -> _Read | str:
    from ros2_mcp.world.occupancy import OccupancyGrid
    from ros2_mcp.world.scans import scan_points

    rows = [row for row in await robot.graph.topics() if row.publishers]
    maps = sorted(row.name for row in rows if OCCUPANCY_GRID in row.types and "costmap" not in row.name)
    scans = sorted(row.name for row in rows if _SCAN in row.types)
    if not maps or not scans:
        return "no map is published" if not maps else "no laser scan is published"
    maps.sort(key=lambda name: (not name.endswith("/map"), len(name)))
    if known and known.map_topic == maps[0]:
        grid = known.grid
    else:
        message: Any = (await next_message(Live(robot).lasting(_MAP_S), maps[0], OCCUPANCY_GRID, silent)).message
        grid = OccupancyGrid(message)
    scan: Any = (await next_message(Live(robot).lasting(_SCAN_S), scans[0], _SCAN, silent)).message
    hits = scan_points(scan).hits
    if len(hits) < _LEAST_HITS:
        return f"only {len(hits)} beams of {named(scans[0])} end at something"
    return _Read(grid, hits, scan.header.frame_id, scans[0], maps[0])
