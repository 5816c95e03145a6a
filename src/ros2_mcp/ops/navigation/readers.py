"""Reads the evidence for the checks of navigation: each part once, all in parallel, without acting on the robot.

A part that cannot be read in time is None and is reported; the other parts are not affected.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from time import monotonic
from typing import Any

import anyio

from ros2_mcp.model import names
from ros2_mcp.model.aside import aside, load
from ros2_mcp.model.errors import BadData, NotFound, RobotError
from ros2_mcp.model.samples import Sample, header_stamp_ns
from ros2_mcp.ops.log.read import LogLine, LogRequest
from ros2_mcp.ops.log.read import read as read_log
from ros2_mcp.ops.measure.diagnostics import Diagnostic, read_diagnostics
from ros2_mcp.ops.navigation.evidence import (
    CLOUD,
    GRID,
    ODOMETRY,
    POSE,
    SCAN,
    SENSORS,
    VELOCITIES,
    Frames,
    Goal,
    Grids,
    Heard,
    NavEvidence,
    Need,
    States,
)
from ros2_mcp.ops.navigation.situation import costmap_of
from ros2_mcp.ops.navigation.targets import Target
from ros2_mcp.ops.navigation.whereabouts import in_frame, why_not_in_frame
from ros2_mcp.ops.nodes.own_services import ask_node, parameter_values
from ros2_mcp.ops.sources.live import Live
from ros2_mcp.ops.sources.source import Capture, GraphSnapshot, Stream
from ros2_mcp.robot import Robot
from ros2_mcp.robot.seen import is_of_robot
from ros2_mcp.robot.transforms import LISTENS
from ros2_mcp.values.writers import Writers

LISTENED_S = 2.0
"""A slow laser scans five times a second and AMCL publishes its transform ten times: a stalled one shows within this
time."""
_SLOW_S = 2.5
"""Additional time for scans of which only one came: together long enough to show a period of more than 2 s, the usual
time-out of a collision monitor's source."""
_GIVEN_UP_S = 8.0
"""For a part as a whole. On a quiet machine all are there within three seconds; on a busy one a late answer is better
than none."""
_ASKED_S = 7.0
"""For questions to all nodes: who has answered by then counts, and who has not does not take the others' answers."""
_ANSWER_S = 1.2
"""Limit for one node: a node that spins answers within milliseconds."""
_AT_A_TIME = 8
_MOST_NODES = 60
"""Number of nodes that are asked, to limit the load on the robot."""
_MOST_OF_TYPE: Mapping[str, int] = {SCAN: 4, ODOMETRY: 4, POSE: 3, "nav2_msgs/msg/CollisionMonitorState": 2}
_MOST_VELOCITIES, _MOST_CLOUDS = 14, 4
_MOST_MAPS = 6
_MOST_MESSAGES = 12
"""Number of scans and the like that are decoded, from the beginning and the end; velocities and odometry are all
decoded.
"""
_FRAMES_S = 1.8
_LOG_S, _LOG_LINES, _LOG_BYTES = 900.0, 300, 60_000
"""The log of the bring-up may explain a failure, as far back as it is kept."""
_LIST = "rcl_interfaces/srv/ListParameters"
_GET_STATE = "lifecycle_msgs/srv/GetState"
_CLOCK_PARAMETER = "use_sim_time"
_TELLS_MORE = ("diff_drive", "base", "ekf", "ukf", "odom", "localization", "slam", "mux", "controller")
"""Parts of the names of other nodes whose parameters matter to navigation."""
_logger = logging.getLogger(__name__)


async def read_evidence(
    robot: Robot, needs: Collection[Need], target: Target | None = None, action: str = ""
) -> tuple[NavEvidence, Mapping[str, str]]:
    """Read the evidence. Return it, and the reason for each part that could not be read. Raises the errors of reading
    the graph.
    """
    await load("ros2_mcp.values.cdr", "ros2_mcp.world.costmap", "ros2_mcp.world.scans")  # with numpy
    source = Live(robot)
    graph = await source.graph()
    makers: dict[Need, Callable[[], Awaitable[Any]]] = {
        "parameters": lambda: _parameters(robot, graph),
        "states": lambda: _states(robot, graph),
        "heard": lambda: _heard(robot, graph),
        "frames": lambda: _frames(robot, graph),
        "grids": lambda: _grids(robot, graph, action),
        "log": lambda: _log(robot),
        "diagnostics": lambda: _diagnostics(robot),
    }
    found: dict[str, Any] = {}
    missed: dict[str, str] = {}

    async def made(need: Need) -> None:
        try:
            with anyio.move_on_after(_GIVEN_UP_S) as scope:
                found[need] = await makers[need]()
            if scope.cancelled_caught:
                missed[need] = f"no answer within {_GIVEN_UP_S:g} s"
        except RobotError as error:
            _logger.info("%s could not be read: %s", need, error)
            missed[need] = str(error).splitlines()[0]

    await asyncio.gather(*(made(need) for need in needs if need in makers))
    # Endpoints may be discovered seconds after their nodes: what is missing counts only if it is still missing now.
    graph = replace(graph, topics=(await source.graph()).topics)
    if frames := found.get("frames"):  # the tree was updated while other parts were read
        found["frames"] = replace(frames, at_ns=robot.now_ns())
    goal = await _goal(robot, target, found.get("grids")) if target else None
    return NavEvidence(graph=graph, goal=goal, now_ns=robot.now_ns(), **found), missed


# ── topics ───────────────────────────────────────────────────────────────────────────────────────────────────────


@dataclass(slots=True)
class _Kept:
    """The messages of one topic: `new` messages with the numbers of their publishers, and `old` messages from before
    the subscription.
    """

    stream: Stream
    new: list[tuple[Sample, int]] = field(default_factory=list[tuple[Sample, int]])
    old: list[Sample] = field(default_factory=list[Sample])
    writers: Writers = field(default_factory=Writers)

    def add(self, samples: Sequence[Sample]) -> None:
        """Take messages in the order of their receipt."""
        for sample in samples:
            if self.stream.is_replayed(sample):
                self.old.append(sample)
            else:
                self.new.append((sample, self.writers.of(sample.sequence, (), sample.received_ns)))


async def _heard(robot: Robot, graph: GraphSnapshot) -> Mapping[str, Heard]:
    """Receive topics of velocities, sensors, odometry and poses; of point clouds, ranges and IMUs only the stamps."""
    whole = _of_types(graph, *VELOCITIES)[:_MOST_VELOCITIES]
    for kind, most in _MOST_OF_TYPE.items():
        whole += [name for name in _of_types(graph, kind) if "initial" not in name][:most]
    stamps = _of_types(graph, CLOUD, "sensor_msgs/msg/Range", "sensor_msgs/msg/Imu")[: 2 * _MOST_CLOUDS]
    source = Live(robot).lasting(LISTENED_S)
    in_full, times = await asyncio.gather(
        source.captures(whole, _Kept), source.captures(stamps, _Kept, times_only=True)
    )
    heard: dict[str, Heard] = {}
    slow = [one for one in in_full if isinstance(one, Capture) and one.type == SCAN and len(one.kept.new) == 1]
    again = await Live(robot).lasting(_SLOW_S).captures([one.topic for one in slow], _Kept) if slow else ()
    later = {one.topic: one for one in again if isinstance(one, Capture)}
    for one in in_full:
        if isinstance(one, Capture):
            heard[one.topic] = await asyncio.to_thread(_decoded, _joined(one, later.get(one.topic)))
    for one in times:
        if isinstance(one, Capture):
            heard[one.topic] = _as_heard(one)
    return heard


def _joined(one: Capture[_Kept], later: Capture[_Kept] | None) -> Capture[_Kept]:
    """Return a capture that goes on until the end of a later one of the same topic."""
    if later is None:
        return one
    one.kept.new += later.kept.new
    return replace(one, end_ns=later.end_ns, received=one.received + later.received)


def _longest_gap_s(capture: Capture[_Kept]) -> float:
    times = [capture.start_ns, *(sample.received_ns for sample, _ in capture.kept.new), capture.end_ns]
    return max(after - before for before, after in pairwise(times)) / 1e9


def _of_types(graph: GraphSnapshot, *types: str) -> list[str]:
    """Return the visible topics whose publishers all have the same type, if it is one of these types."""
    return [
        name
        for name, topic in sorted(graph.topics.items())
        if len({one.type for one in topic.publishers}) == 1
        and topic.publishers[0].type in types
        and not names.is_hidden(name)
    ]


def _as_heard(
    capture: Capture[_Kept], messages: Sequence[tuple[int, Any, int]] = (), kept: Sequence[Any] = ()
) -> Heard:
    stamps = [
        (sample.received_ns, header_stamp_ns(sample.data)) for sample, _ in capture.kept.new if _is_stamped(capture)
    ]
    newest = messages[-1][1] if messages else kept[-1] if kept else None
    header = getattr(newest, "header", None)
    return Heard(
        topic=capture.topic,
        type=capture.type,
        nodes=capture.publishers,
        count=len(capture.kept.new),
        duration_s=capture.duration_s,
        messages=messages,
        kept=kept,
        ages_s=[(received_ns - stamp_ns) / 1e9 for received_ns, stamp_ns in stamps if stamp_ns],
        frame_id=str(header.frame_id).lstrip("/") if header else "",
        longest_gap_s=_longest_gap_s(capture),
    )


def _is_stamped(capture: Capture[_Kept]) -> bool:
    return capture.type in (*SENSORS, ODOMETRY, "sensor_msgs/msg/Imu", VELOCITIES[1])


def _decoded(capture: Capture[_Kept]) -> Heard:
    new = capture.kept.new
    if capture.type not in (*VELOCITIES, ODOMETRY) and len(new) > _MOST_MESSAGES:
        new = [*new[: _MOST_MESSAGES // 2], *new[-_MOST_MESSAGES // 2 :]]
    messages: list[tuple[int, Any, int]] = []
    for sample, writer in new:
        try:
            messages.append((sample.received_ns, capture.codec.decode(capture.type, sample.data), writer))
        except BadData:
            continue
    try:
        kept = [capture.codec.decode(capture.type, sample.data) for sample in capture.kept.old[-1:]]
    except BadData:
        kept = []
    return _as_heard(capture, messages, kept)


# ── nodes ────────────────────────────────────────────────────────────────────────────────────────────────────────


async def _parameters(robot: Robot, graph: GraphSnapshot) -> Mapping[str, Mapping[str, Any]]:
    """Read all parameters of Nav2's nodes and of related nodes; of other nodes only use_sim_time."""
    found: dict[str, Mapping[str, Any]] = {}
    limit = asyncio.Semaphore(_AT_A_TIME)
    evidence = NavEvidence(graph=graph)
    whole = set(evidence.robots_nodes) | {
        node for node in evidence.nodes if any(part in node.rpartition("/")[2] for part in _TELLS_MORE)
    }

    async def asked(node: str) -> None:
        async with limit:
            try:
                with anyio.move_on_after(2 * _ANSWER_S):
                    wanted = await declared_by(robot, node) if node in whole else [_CLOCK_PARAMETER]
                    found[node] = await values_of(robot, node, wanted)
            except RobotError:  # the node has left, hangs, or has no parameter services
                pass

    nodes = [node for node in dict.fromkeys(evidence.nodes) if is_of_robot(node) and node != names.UNKNOWN_NODE]
    servers = set(evidence.robots_nodes)
    nodes.sort(key=lambda node: (node not in servers, node not in whole))
    with anyio.move_on_after(_ASKED_S):
        await asyncio.gather(*map(asked, nodes[:_MOST_NODES]))
        await asyncio.gather(*(asked(node) for node in nodes[:_MOST_NODES] if node in whole and node not in found))
    return found


async def declared_by(robot: Robot, node: str) -> Sequence[str]:
    """Return the names of a node's parameters. Raises `RobotError` if it does not answer in time."""
    request: Mapping[str, Any] = {"prefixes": [], "depth": 0}
    answer = await ask_node(robot, node, _LIST, request, timeout_s=_ANSWER_S, wait_s=0.0)
    declared: Sequence[str] = (await robot.fields_of(answer))["result"]["names"]
    return [name for name in declared if not name.startswith("qos_overrides.")]


async def values_of(robot: Robot, node: str, wanted: Sequence[str]) -> Mapping[str, Any]:
    """Return parameters of a node by name, without those that have no value. Raises `RobotError` if it does not answer
    in time."""
    return await parameter_values(robot, node, wanted, timeout_s=_ANSWER_S, wait_s=0.0)


async def _states(robot: Robot, graph: GraphSnapshot) -> States:
    """Read the lifecycle states of all nodes that have such a state, "" for nodes that do not answer; each node is
    asked twice.
    """
    nodes = [name.rpartition("/")[0] for name, types in (graph.services or {}).items() if _GET_STATE in types]
    limit = asyncio.Semaphore(_AT_A_TIME)
    states, answered_s = dict[str, str](), dict[str, float]()

    async def asked(node: str) -> None:
        async with limit:
            began_at = monotonic()
            try:
                answer = await ask_node(robot, node, _GET_STATE, {}, timeout_s=_ANSWER_S, wait_s=_ANSWER_S)
            except RobotError as error:
                if not isinstance(error, NotFound) or node in (graph.nodes or ()):
                    states.setdefault(node, "")
                return
            answered_s[node] = min(monotonic() - began_at, answered_s.get(node, _ANSWER_S))
            states[node] = str((await robot.fields_of(answer))["current_state"]["label"])

    with anyio.move_on_after(_ASKED_S):
        await asyncio.gather(*map(asked, nodes))
        # Again: a node may be busy for a second, and the first question waits for its service to be matched.
        await asyncio.gather(*map(asked, nodes))
    return States(states, answered_s)


# ── the rest ─────────────────────────────────────────────────────────────────────────────────────────────────────


async def _frames(robot: Robot, graph: GraphSnapshot) -> Frames:
    from ros2_mcp.ops.space.frames import frames_of
    from ros2_mcp.ops.space.tellers import tellers_of

    listener = Live(robot).transforms
    await frames_of(Live(robot), until=lambda _: False, patience_s=_FRAMES_S)
    if listener and listener.listened_s < _FRAMES_S:
        await asyncio.sleep(_FRAMES_S - listener.listened_s)
    tree = await frames_of(Live(robot), until=lambda tree: bool(tree.frames), patience_s=0.1)
    tellers = await tellers_of(Live(robot), tree)
    owners = {
        name: sorted({one.node for one in graph.topics[tree.namespace + name].publishers})
        for name in LISTENS
        if tree.namespace + name in graph.topics
    }
    return Frames(
        tree=tree,
        tellers=tellers,
        at_ns=robot.now_ns(),
        listened_s=listener.listened_s if listener else 0.0,
        owners=owners,
    )


async def _grids(robot: Robot, graph: GraphSnapshot, action: str) -> Grids:
    from ros2_mcp.world.costmap import CostGrid

    rows = list(await robot.graph.topics())
    maps = [name for name in _of_types(graph, GRID) if "costmap" not in name and name.rpartition("/")[2] == "map"]

    async def the_maps() -> list[CostGrid]:
        """Return the map; if several nodes publish it, each different map: every publisher keeps its own for late
        subscribers.
        """
        if not maps:
            return []
        several = len(graph.topics[maps[0]].publishers) > 1
        async with robot.listen(maps[0], keep="all" if several else "latest") as listening:
            if several:
                samples = [sample async for sample in listening.samples(LISTENED_S)][-_MOST_MAPS:]
            else:
                samples = (await listening.take(LISTENED_S))[-1:]
            found: dict[Any, CostGrid] = {}
            for sample in samples:
                message = (await robot.values.decode_all(listening.type, [sample]))[0]
                try:
                    grid = await aside(len(sample.data), CostGrid, message)
                except BadData:
                    continue
                where = (grid.corner.x_m, grid.corner.y_m, grid.corner.yaw_rad)
                found[grid.frame_id, grid.resolution_m, where, grid.cells.shape, grid.cells.tobytes()] = grid
            return list(found.values())

    different, (costs, topic, _) = await asyncio.gather(the_maps(), costmap_of(robot, rows, action))
    return Grids(
        map=different[-1] if different else None,
        map_topic=maps[0] if maps else "",
        maps=different,
        costs=costs if "costmap" in topic else None,
        costs_topic=topic if "costmap" in topic else "",
    )


async def _log(robot: Robot) -> Sequence[LogLine]:
    """Read warnings and errors of all nodes, and the lines of lifecycle managers that all nodes are active: they make
    earlier errors obsolete."""
    since = f"{_LOG_S:.0f}"
    warnings, ups = await asyncio.gather(
        read_log(robot, LogRequest(since=since, level="warn", limit=_LOG_LINES), _LOG_BYTES),
        read_log(robot, LogRequest(since=since, node="*lifecycle_manager*", pattern="anaged nodes"), _LOG_BYTES),
    )
    lines = {(line.time, line.node, line.text): line for line in (*warnings.lines, *ups.lines)}
    return sorted(lines.values(), key=lambda line: line.time)


async def _diagnostics(robot: Robot) -> Sequence[Diagnostic]:
    try:
        return (await read_diagnostics(robot)).rows
    except NotFound:  # /diagnostics has no publisher
        return ()


async def _goal(robot: Robot, target: Target, grids: Grids | None) -> Goal:
    frame = grids.costs.frame_id if grids and grids.costs else "map"
    at = await in_frame(robot, target.frame, target.x_m, target.y_m, frame)
    if at is None:
        return Goal(x_m=target.x_m, y_m=target.y_m, why_not=await why_not_in_frame(robot, target.frame, frame))
    return Goal(x_m=at[0], y_m=at[1])
