"""Collects what is known around a failed goal: costmap, localisation, sensors, servers, diagnostics, the log.

Each part is read independently. A part that cannot be read is described in words; nothing here fails.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from time import monotonic
from typing import TYPE_CHECKING, Any

from ros2_mcp.model.aside import aside, load
from ros2_mcp.model.costs import cost_in_words
from ros2_mcp.model.errors import BadData, RobotError, TimedOut
from ros2_mcp.model.graph import TopicRow
from ros2_mcp.model.nav2 import COSTMAP, COSTMAP_UPDATE, GRID_UPDATE, NAVIGATION_NODES, is_drawn_by_nav2
from ros2_mcp.model.pictures import OCCUPANCY_GRID
from ros2_mcp.model.text import LOG_LINE, named, quoted
from ros2_mcp.ops.log.read import Log, LogLine, LogRequest
from ros2_mcp.ops.log.read import read as read_log
from ros2_mcp.ops.measure.diagnostics import Diagnostic, read_diagnostics
from ros2_mcp.ops.navigation.base import Base, base_of
from ros2_mcp.ops.navigation.costmaps import chosen_costmaps, costmap_now, updates_of
from ros2_mcp.ops.navigation.evidence import NavFinding
from ros2_mcp.ops.navigation.whereabouts import Whereabouts, whereabouts
from ros2_mcp.ops.nodes.lifecycle import states
from ros2_mcp.ops.sources.live import Live
from ros2_mcp.robot import Robot

if TYPE_CHECKING:
    from ros2_mcp.world.costmap import CostGrid

COSTMAP_S = 3.0
"""Nav2 publishes a costmap once a second, and the last costmap is latched; a publisher may be discovered late."""
_SENSORS_S = 1.5
"""The slowest scanners scan five times a second, and Nav2 publishes a costmap once; matching takes up to 0.2 s."""
_LOG_BEFORE_S = 1.0
"""Lines of the log are stamped before the goal's answer arrives."""
_MOST_LINES = 60
_MOST_SENSORS = 6
_SENSOR_TYPES = ("sensor_msgs/msg/LaserScan", "sensor_msgs/msg/PointCloud2", "nav_msgs/msg/Odometry")
_AHEAD_DEG = 20.0
"""Angle to either side that counts as ahead: half of the sector that a laser's meaning calls front."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Local:
    """The local costmap around the robot: the cost at its centre (None: off the grid), and the distance in m and
    direction in degrees to the left of ahead of the nearest occupied cell (None: no cell is occupied)."""

    topic: str
    cost: int | None
    away_m: float | None = None
    bearing_deg: float | None = None

    def __str__(self) -> str:
        here = f"On {named(self.topic)} the robot's centre is {cost_in_words(self.cost)}"
        if self.away_m is None or self.bearing_deg is None:
            return f"{here}, and nothing stands on it"
        side = "left" if self.bearing_deg > 0 else "right"
        is_ahead = abs(self.bearing_deg) < _AHEAD_DEG
        where = " ahead" if is_ahead else f", {abs(self.bearing_deg):.0f}° to the {side}"
        return f"{here}; the nearest obstacle is {self.away_m:.2f} m from it{where}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Situation:
    """The state around a failed goal. `grid_topic` is the topic of the costmap, or of the map in its place.

    `inactive` are Nav2's nodes that are not active, with their states; `silent` are topics of sensors or odometry with
    publishers but without messages; `local` is the local costmap around the robot; `base` says who else commands the
    base and which limits are 0. `findings` are those of `ros2_nav_check`, `absent` sentences on parts that could not be
    read.
    """

    where: Whereabouts
    grid: CostGrid | None = None
    grid_topic: str = ""
    inactive: Sequence[str] = ()
    silent: Sequence[str] = ()
    diagnostics: Sequence[Diagnostic] = ()
    lines: Sequence[LogLine] = ()
    local: Local | None = None
    base: Base = field(default=Base())
    findings: Sequence[NavFinding] = ()
    absent: Sequence[str] = field(default=())


async def look_around(robot: Robot, frame: str, since_s: float, action: str = "") -> Situation:
    """Read the state of the robot and its surroundings in `frame`, with the log of the last `since_s` s."""
    absent: list[str] = []
    rows = await _or(robot.graph.topics(), (), absent, "The topics")
    topics = list(rows)
    beside = asyncio.gather(local_of(robot, topics, action), base_of(robot))
    where, (grid, grid_topic, ages), inactive, quiet, table, log = await asyncio.gather(
        whereabouts(robot, frame),
        costmap_of(robot, topics, action, within_s=_SENSORS_S),
        inactive_servers(robot),
        sensors_of(robot, topics),
        _or(read_diagnostics(robot), None, [], ""),
        _or(_log(robot, since_s), None, absent, "The log"),
    )
    local, base = await beside
    if grid is None:
        absent.append("No costmap and no map could be read.")
    if ages:
        absent.append(ages)
    return Situation(
        where=where,
        grid=grid,
        grid_topic=grid_topic,
        inactive=inactive,
        silent=quiet,
        diagnostics=[row for row in table.rows if row.level != "OK"] if table else (),
        lines=_different(log.lines) if log else (),
        local=local,
        base=base,
        absent=absent,
    )


async def _or(work: Any, otherwise: Any, absent: list[str], what: str) -> Any:
    try:
        return await work
    except RobotError as error:
        if what:
            absent.append(f"{what} could not be read: {error.message}")
        return otherwise


async def costmap_of(
    robot: Robot, topics: Sequence[TopicRow], action: str = "", *, within_s: float = 0.0
) -> tuple[CostGrid | None, str, str]:
    """Return the global costmap, else the map, with its topic, and a sentence on the age of the costmap and its
    updates.

    The grid is None if neither can be read; then the sentence says why a grid could not be used. With several robots
    the costmap is that in the namespace of `action`. Takes the newest message within `within_s`: the first one is
    latched, and may be older than the goal.
    """
    grids = _grids(topics)
    namespace = action.rpartition("/")[0]
    own = [name for name in grids if name.startswith(f"{namespace}/")] or grids
    wanted = sorted(own, key=lambda name: ("global_costmap" not in name, "costmap" in name, len(name)))
    said: list[str] = []
    for name in wanted[:2]:
        if "local_costmap" in name:
            continue
        try:
            grid, ages = await _newest_grid(robot, topics, name, within_s)
            return grid, name, " ".join(filter(None, (*said, ages)))
        except BadData as error:
            said.append(f"{named(name)} cannot be used: {error.message}")
        except RobotError:
            continue
    return None, "", " ".join(said)


async def local_of(robot: Robot, topics: Sequence[TopicRow], action: str = "") -> Local | None:
    """Return the surroundings on the local costmap; None without a local costmap, or if the robot's pose on it is
    unknown.
    """
    grids = [name for name in _grids(topics) if "local_costmap" in name]
    namespace = action.rpartition("/")[0]
    own = sorted([name for name in grids if name.startswith(f"{namespace}/")] or grids, key=len)
    if not own:
        return None
    try:
        grid, _ = await _newest_grid(robot, topics, own[0], _SENSORS_S)
    except RobotError:
        return None
    where = await whereabouts(robot, grid.frame_id)
    if where.x_m is None or where.y_m is None or where.trouble:
        return None
    return around(grid, own[0], where)


def around(grid: CostGrid, topic: str, where: Whereabouts) -> Local:
    """Return the surroundings of the robot on a costmap; `where` is in the costmap's frame."""
    x_m, y_m = where.x_m or 0.0, where.y_m or 0.0
    nearest = grid.nearest_occupied(x_m, y_m)
    if nearest is None:
        return Local(topic=topic, cost=grid.value(x_m, y_m))
    bearing_rad = math.remainder(math.atan2(nearest[1] - y_m, nearest[0] - x_m) - (where.yaw_rad or 0.0), 2 * math.pi)
    away_m = math.hypot(nearest[0] - x_m, nearest[1] - y_m)
    return Local(
        topic=topic, cost=grid.value(x_m, y_m), away_m=round(away_m, 2), bearing_deg=round(math.degrees(bearing_rad))
    )


def _published(topics: Sequence[TopicRow], *types: str) -> list[str]:
    return [row.name for row in topics if row.publishers and not set(types).isdisjoint(row.types)]


def _grids(topics: Sequence[TopicRow]) -> list[str]:
    return chosen_costmaps(_published(topics, OCCUPANCY_GRID), _published(topics, COSTMAP))


async def _newest_grid(robot: Robot, topics: Sequence[TopicRow], topic: str, within_s: float) -> tuple[CostGrid, str]:
    """Return a grid, and a sentence on its age and that of its updates ("" if it has no updates); raises as
    `costmap_now`."""
    await load("ros2_mcp.world.costmap")  # with numpy: not before it is needed
    from ros2_mcp.world.costmap import CostGrid

    kind = COSTMAP if topic in _published(topics, COSTMAP) else OCCUPANCY_GRID
    updates = updates_of(topic, _published(topics, GRID_UPDATE, COSTMAP_UPDATE))
    if updates or kind == COSTMAP:
        found = await costmap_now(robot, Live(robot), topic, kind, updates, COSTMAP_S, newer_s=within_s)
        return found.grid, found.note
    async with robot.listen(topic, keep="latest") as listening:
        samples = await listening.take(COSTMAP_S)
        end = monotonic() + within_s
        while samples and (left_s := end - monotonic()) > 0:
            samples = await listening.take(left_s) or samples
        if not samples:
            raise TimedOut(f"No message on {topic}.")
        message = (await robot.values.decode_all(listening.type, samples[-1:]))[0]
        return await aside(len(samples[-1].data), CostGrid, message), ""


async def inactive_servers(robot: Robot) -> list[str]:
    """Return a sentence for each of Nav2's lifecycle nodes that is not active."""
    try:
        every = [
            row.name.rpartition("/")[0]
            for row in await robot.graph.services()
            if "lifecycle_msgs/srv/GetState" in row.types
        ]
        chosen = sorted({node for node in every if node.rpartition("/")[2] in NAVIGATION_NODES})
        found = await states(robot, chosen) if chosen else None
    except RobotError:
        return []
    nodes = found.nodes if found else ()
    silent_ones = [f"{named(one.node)} does not answer" for one in nodes if one.error]
    return silent_ones + [
        f"{named(one.node)} is {named(one.state)}" for one in nodes if not one.error and one.state != "active"
    ]


async def sensors_of(robot: Robot, topics: Sequence[TopicRow]) -> list[str]:
    """Return the topics of sensors and odometry that are silent, without the topics that Nav2 publishes to draw its
    costmaps.
    """
    known = [row.name for row in topics if row.publishers and set(row.types) & set(_SENSOR_TYPES)]
    present = await asyncio.gather(*map(robot.graph.endpoints, known[:_MOST_SENSORS]))
    known = [one.topic for one in present if not is_drawn_by_nav2(one)]
    heard = await asyncio.gather(*(_hears(robot, name) for name in known))
    return [name for name, comes in zip(known, heard, strict=True) if not comes]


async def _hears(robot: Robot, topic: str) -> bool:
    try:
        async with robot.listen(topic, keep="latest", head_bytes=16) as listening:
            end = monotonic() + _SENSORS_S
            while (left_s := end - monotonic()) > 0:
                if await listening.take(left_s):
                    return True
    except RobotError:
        return True  # a topic that cannot be subscribed to is not reported as silent
    return False


async def _log(robot: Robot, since_s: float) -> Log:
    request = LogRequest(since=f"{since_s + _LOG_BEFORE_S:.3f}", level="warn", limit=_MOST_LINES)
    return await read_log(robot, request, 8_000)


def _different(lines: Sequence[LogLine]) -> list[LogLine]:
    """Return the lines without repetitions; of equal lines of a node the last line stays."""
    return list({(line.node, line.text): line for line in reversed(lines)}.values())[::-1]


def is_of_navigation(line: LogLine) -> bool:
    """Whether a Nav2 node logged the line."""
    return not set(line.node.split("/")).isdisjoint(NAVIGATION_NODES)


def line_in_words(line: LogLine) -> str:
    """Return a log line as part of a sentence."""
    return f"{named(line.node)} {line.level}: {quoted(line.text, LOG_LINE)}"
