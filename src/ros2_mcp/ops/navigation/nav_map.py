"""`ros2_nav_map`: show, save and load maps with map_server, map_saver and slam_toolbox, and verify what can be
verified."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from time import monotonic
from typing import Any, Literal

from ros2_mcp.model import parameters
from ros2_mcp.model.aside import load
from ros2_mcp.model.errors import BadInput, RobotError
from ros2_mcp.model.nav2 import LOAD_MAP, LOAD_POSE_GRAPH, SAVE_MAP, SAVE_POSE_GRAPH, SLAM_SAVE_MAP
from ros2_mcp.model.pictures import OCCUPANCY_GRID
from ros2_mcp.model.text import listed, named, quoted
from ros2_mcp.model.times import iso_time
from ros2_mcp.ops.log.complaints import complaints_from_now
from ros2_mcp.ops.navigation.known_places import places_of
from ros2_mcp.ops.navigation.last_costmaps import sent_ns
from ros2_mcp.ops.navigation.last_pose import MapMark, last_pose_of
from ros2_mcp.ops.navigation.scan_fit import ScanFit, scan_fit
from ros2_mcp.ops.navigation.targets import targets_of
from ros2_mcp.ops.nodes.own_services import ask_node
from ros2_mcp.ops.results.results import SAID, Report, silent
from ros2_mcp.ops.services.call import call
from ros2_mcp.robot import Robot
from ros2_mcp.robot.session import Session

MapVerb = Literal["show", "save", "load"]
_SERVICES: Mapping[tuple[str, bool], Sequence[str]] = {
    ("save", False): (SAVE_MAP, SLAM_SAVE_MAP),
    ("load", False): (LOAD_MAP,),
    ("save", True): (SAVE_POSE_GRAPH,),
    ("load", True): (LOAD_POSE_GRAPH,),
}
"""What is done, and whether with slam_toolbox's pose graph → types of services, the preferred one first."""
MAP_SERVICES = (LOAD_MAP, SAVE_MAP, SLAM_SAVE_MAP, SAVE_POSE_GRAPH, LOAD_POSE_GRAPH)
_WORDS: Mapping[str, Mapping[int, str]] = {
    LOAD_MAP: {
        0: "loaded",
        1: "there is no such map",
        2: "its image cannot be read",
        3: "its YAML file cannot be read, or lacks something",
        255: "it failed for a reason without a code",
    },
    SAVE_MAP: {1: "saved", 0: "it was not saved"},
    SLAM_SAVE_MAP: {0: "saved", 1: "slam_toolbox has no map yet", 255: "it failed for a reason without a code"},
    SAVE_POSE_GRAPH: {0: "saved", 255: "the file could not be written"},
    LOAD_POSE_GRAPH: {
        0: "loaded",
        1: "the file name is not valid",
        2: "this mode of slam_toolbox cannot start like that",
        3: "the file cannot be read",
        255: "it failed for a reason without a code",
    },
}
"""Codes of the responses in words; SaveMap of Nav2 answers with true or false."""
_ENDINGS = {SAVE_MAP: (".yaml", ".pgm"), SLAM_SAVE_MAP: (".yaml", ".pgm"), SAVE_POSE_GRAPH: (".posegraph", ".data")}
_TIMEOUT_S = 40.0
"""Writing or reading a large map takes seconds."""
_MAP_S = 2.0
_APPEARS_S = 6.0
"""A loaded map is published at once; slam_toolbox publishes its own every few seconds."""
_CLOCKS_S = 2.0
"""Difference between a computer's clock and the times of its file system or of another computer."""
_SIMULATED_S = 1_000_000_000
"""Earlier times (before 2001) are not set, or simulated."""
_MOST_MAPS = 6


@dataclass(frozen=True, slots=True, kw_only=True)
class MapSeen:
    """A map as it is published: cells, m per cell, the pose of its corner (m), the share of cells that are occupied or
    unknown, and when it was loaded by its own stamp."""

    topic_name: str
    width: int
    height: int
    resolution_m: float
    x_m: float
    y_m: float
    occupied: float
    unknown: float
    loaded_at: str = ""

    def __str__(self) -> str:
        wide, high = self.width * self.resolution_m, self.height * self.resolution_m
        loaded = f", loaded at {self.loaded_at}" if self.loaded_at else ""
        return (
            f"{named(self.topic_name)}: {self.width} × {self.height} cells of {self.resolution_m:g} m ({wide:.1f} × "
            f"{high:.1f} m) from ({self.x_m:.2f}, {self.y_m:.2f}), {self.occupied:.0%} occupied, {self.unknown:.0%} "
            f"unknown{loaded}"
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class NavMap:
    """What was done, through which service, and whether it succeeded (null: only shown, or the service does not say).

    `maps` are the maps that are published now. `verified` says what was checked afterwards. `services` lists the
    services found, as name (type), and `files` the map files, as node: file.
    """

    done: str = field(metadata=SAID)
    through: str = ""
    successful: bool | None = None
    said: str = field(default="", metadata=SAID)
    verified: str = field(default="", metadata=SAID)
    fit: str = field(default="", metadata=SAID)
    maps: Sequence[MapSeen] = field(default=(), metadata=SAID)
    services: Sequence[str] = ()
    files: Sequence[str] = ()
    note: str = field(default="", metadata=SAID)

    @property
    def has_failed(self) -> bool:
        """Whether the service says that it failed."""
        return self.successful is False

    def summary(self) -> list[str]:
        """Return what was done and verified, and the maps."""
        verdict = {True: "done", False: "FAILED", None: ""}[self.successful]
        first = ": ".join(filter(None, (self.done, verdict, self.said)))
        lines = [f"{first}. {self.note}".strip(), self.verified, *map(str, self.maps), self.fit]
        return [line for line in lines if line]


@dataclass(frozen=True, slots=True, kw_only=True)
class MapRequest:
    """What to do with the map at `path`, on the computer of the service. `at`: the pose at which slam_toolbox
    continues.
    """

    what: MapVerb = "show"
    path: str = ""
    pose_graph: bool = False
    at: object = None
    service: str = ""


async def nav_map(robot: Robot, session: Session, request: MapRequest, report: Report = silent) -> NavMap:
    """Show what maps and services there are, or save or load a map.

    Raises:
        BadInput: for a missing path, or several services of which none is chosen.
        NotFound: if no service offers it.
        RobotError: what calling the service raises.
    """
    await load("ros2_mcp.world.occupancy")  # with numpy: not before it is needed
    if request.what == "show":
        return await _shown(robot)
    if not request.path.strip():
        raise BadInput("`path` is missing.", "Give a path on the robot's computer, such as /maps/floor1.")
    if request.at is not None and not (request.what == "load" and request.pose_graph):
        raise BadInput(
            "`at` is only for a pose graph: it says where slam_toolbox continues.",
            "Leave `at` out; see ros2_nav_localize.",
        )
    service, kind = await _service(robot, request)
    await robot.values.learn(kind)
    topic = await _topic(robot, service)
    before = await _map(robot, topic)
    complaints = complaints_from_now(robot)
    value = {**robot.values.example(f"{kind}_Request"), **_request(robot, request, kind, topic)}
    called_at = time.time()
    answer = await call(robot, session, service, kind, value, timeout_s=_TIMEOUT_S, report=report)
    code = (answer.result or {}).get("result") if answer.called else None
    notes = [answer.note]
    successful = None if code is None else _WORDS[kind].get(int(code)) in ("saved", "loaded")
    if not answer.called or successful is False:
        notes.append(await complaints.said())
        words = _WORDS[kind].get(int(code), f"code {code}") if code is not None else "it was not called"
        return NavMap(
            done=_done(request),
            through=f"{service} ({kind})",
            successful=False,
            said=words,
            note=" ".join(filter(None, notes)),
        )
    if request.what == "save":
        verified, now, fit = written(robot, request.path, kind, called_at), before, ""
    else:
        last_pose_of(robot).forget_map()
        verified, now = await _published(robot, topic, before)
        fit = _fit(await scan_fit(robot))
    return NavMap(
        done=_done(request),
        through=f"{service} ({kind})",
        successful=successful,
        said="" if successful else "the service does not say whether it succeeded",
        verified=verified,
        fit=fit,
        maps=[now[0]] if now else [],
        note=" ".join(filter(None, notes)),
    )


def _done(request: MapRequest) -> str:
    what = "the pose graph" if request.pose_graph else "the map"
    return f"{request.what} {what} {quoted(request.path)}"


def _fit(fit: ScanFit | str) -> str:
    told = str(fit) if isinstance(fit, ScanFit) else f"not known ({fit})"
    return f"Fit of the scan where localisation has the robot now: {told}. ros2_nav_localize tells it where it is."


async def _service(robot: Robot, request: MapRequest) -> tuple[str, str]:
    """Return the name and type of the service that does what is requested."""
    wanted = _SERVICES[request.what, request.pose_graph]
    rows = [(row.name, kind) for row in await robot.graph.services() for kind in row.types if kind in wanted]
    if request.service:
        name = request.service if request.service.startswith("/") else f"/{request.service}"
        rows = [row for row in rows if row[0] == name]
    if not rows:
        which = f"{named(request.service)} is no" if request.service else "There is no"
        raise await robot.graph.missing(
            f"{which} service of type {' or '.join(wanted)}.",
            "map_server loads, map_saver saves, slam_toolbox does both; ros2_nav_map shows what there is.",
        )
    best = [row for row in rows if row[1] == min((kind for _, kind in rows), key=wanted.index)]
    plain = [row for row in best if row[0].rpartition("/")[0].endswith("/map_server")]
    chosen = plain if len(best) > 1 and len(plain) == 1 else best
    if len(chosen) > 1:
        raise BadInput(f"There are several: {listed(sorted(name for name, _ in chosen), 5)}.", "Give service_name.")
    return chosen[0]


def _request(robot: Robot, request: MapRequest, kind: str, topic: str) -> dict[str, Any]:
    path = request.path.strip()
    if request.what == "save":
        path = path.removesuffix(".yaml")
    if kind == SAVE_MAP:
        numbers = {"free_thresh": 0.25, "occupied_thresh": 0.65}
        return {"map_topic": topic, "map_url": path, "image_format": "pgm", "map_mode": "trinary", **numbers}
    if kind == SLAM_SAVE_MAP:
        return {"name": {"data": path}}
    if kind == SAVE_POSE_GRAPH:
        return {"filename": path}
    if kind == LOAD_MAP:
        return {"map_url": path}
    if request.at is None:
        return {"filename": path, "match_type": 1}  # START_AT_FIRST_NODE
    (target, *_) = targets_of(request.at, places_of(robot))
    example: Mapping[str, Any] = robot.values.example(f"{kind}_Request")["initial_pose"]
    at: Mapping[str, Any] = target.pose()["pose"]
    if "theta" in example:
        at = {"x": target.x_m, "y": target.y_m, "theta": target.yaw_rad or 0.0}
    return {"filename": path, "match_type": 2, "initial_pose": at}  # START_AT_GIVEN_POSE


async def _shown(robot: Robot) -> NavMap:
    topics, services = await asyncio.gather(robot.graph.topics(), robot.graph.services())
    rows = [row.name for row in topics if row.publishers and OCCUPANCY_GRID in row.types and "costmap" not in row.name]
    rows.sort(key=lambda name: (not name.endswith("/map"), name))
    seen = await asyncio.gather(*(_map(robot, name) for name in rows[:_MOST_MAPS]))
    offered = [(row.name, kind) for row in services for kind in row.types if kind in MAP_SERVICES]
    if not rows and not offered:
        raise await robot.graph.missing(
            "No map is published, and no service loads or saves one.", "Neither map_server nor slam_toolbox is running."
        )
    hosts = sorted(name.rpartition("/")[0] for name, kind in offered if kind == LOAD_MAP)
    files = [f"{host}: {file}" for host in hosts if (file := await _file_of(robot, host))]
    silent_ones = [name for name, one in zip(rows, seen, strict=False) if one is None]
    return NavMap(
        done=f"{len(rows)} published, {len(offered)} services",
        maps=[one[0] for one in seen if one],
        services=[f"{name} ({kind})" for name, kind in sorted(offered)],
        files=files,
        note=f"No message on {listed(silent_ones, 5)}." if silent_ones else "",
    )


async def _file_of(robot: Robot, node: str) -> str:
    with suppress(RobotError):
        kind, request = "rcl_interfaces/srv/GetParameters", {"names": ["yaml_filename"]}
        answer = await ask_node(robot, node, kind, request, timeout_s=1.0)
        values = (await robot.fields_of(answer))["values"]
        return str(parameters.value_of(values[0]) or "") if values else ""
    return ""


async def _topic(robot: Robot, service: str) -> str:
    """Return the topic of the map that a service is about: that of its node, else the map that all use."""
    node = service.rpartition("/")[0]
    rows = [row.name for row in await robot.graph.topics() if OCCUPANCY_GRID in row.types and "costmap" not in row.name]
    ends = await asyncio.gather(*map(robot.graph.endpoints, rows))
    own = [one.topic for one in ends if any(each.node == node for each in one.publishers)]
    return min(own or rows or ["/map"], key=lambda name: (not name.endswith("/map"), len(name)))


_Known = tuple[MapSeen, MapMark, int]
"""A map as it is shown, its mark, and when it was sent (ns, by its publisher)."""


async def _map(robot: Robot, topic: str) -> _Known | None:
    """Return the map that a topic has now; None if there is no message, or no valid map."""
    with suppress(RobotError):
        async with robot.listen(topic, OCCUPANCY_GRID, keep="latest") as listening:
            if samples := await listening.take(_MAP_S):
                return await _known(robot, topic, listening.type, samples[-1])
    return None


async def _published(robot: Robot, topic: str, before: _Known | None) -> tuple[str, _Known | None]:
    """Wait until a topic has a later map than `before`; return what was seen of it in words, and the map."""
    end, found, is_new = monotonic() + _APPEARS_S, before, False
    with suppress(RobotError):
        async with robot.listen(topic, OCCUPANCY_GRID, keep="latest") as listening:
            while not is_new and (left_s := end - monotonic()) > 0:
                for sample in await listening.take(left_s):
                    found = await _known(robot, topic, listening.type, sample)
                    is_new = before is None or found[2] > before[2]
    if not is_new or found is None:
        return f"NOT verified: no new map came on {named(topic)} within {_APPEARS_S:g} s.", found
    if before is None:
        return f"Verified: {named(topic)} has a map now, and had none before.", found
    if difference := before[1].difference(found[1]):
        return f"Verified: a new map came on {named(topic)}; {difference}. Before: {before[0]}.", found
    return f"Verified: a map came on {named(topic)}, with the same cells as before.", found


async def _known(robot: Robot, topic: str, kind: str, sample: Any) -> _Known:
    from ros2_mcp.world.occupancy import OccupancyGrid

    message: Any = (await robot.values.decode_all(kind, [sample]))[0]
    grid = OccupancyGrid(message)
    facts = grid.facts()
    loaded = message.info.map_load_time
    seen = MapSeen(
        topic_name=topic,
        width=facts.width,
        height=facts.height,
        resolution_m=round(facts.resolution_m, 6),
        x_m=round(grid.corner.x_m, 4),
        y_m=round(grid.corner.y_m, 4),
        occupied=round(facts.occupied, 4),
        unknown=round(facts.unknown, 4),
        loaded_at=iso_time(loaded.sec * 1_000_000_000 + loaded.nanosec) if loaded.sec > _SIMULATED_S else "",
    )
    return seen, MapMark.of(topic, grid), sent_ns(sample)


def written(robot: Robot, given: str, kind: str, called_at: float) -> str:
    """Say whether the files are there, if that can be seen from here."""
    path = given.strip().removeprefix("file://").removesuffix(".yaml")
    names = [f"{path}{ending}" for ending in _ENDINGS[kind]]
    if robot.graph.is_remote:
        return "NOT verified: the files are on the robot's computer, which cannot be looked at from here."
    if not PurePosixPath(path).is_absolute():
        return "NOT verified: the path is relative to the folder of that node, which is not known here."
    told: list[str] = []
    for name in names:
        try:
            found = Path(name).stat()
        except OSError:
            return f"NOT verified: there is no {quoted(name)} on this computer; it may be on the robot's."
        if found.st_mtime < called_at - _CLOCKS_S:
            return f"NOT verified: {quoted(name)} on this computer is older than the call."
        told.append(f"{quoted(name)} ({found.st_size} bytes)")
    return f"Verified: {' and '.join(told)} were written on this computer."
