"""`ros2_robot`: kind, command inputs, sensors, pose and faults of the robot in 4 kB."""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Awaitable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from time import monotonic
from typing import Any

import anyio

from ros2_mcp.model.aside import load
from ros2_mcp.model.errors import NotFound, RobotError, UnknownInterface
from ros2_mcp.model.graph import TopicEndpoints
from ros2_mcp.model.pictures import RobotPlace
from ros2_mcp.model.text import named, quoted
from ros2_mcp.ops.measure.diagnostics import LEVELS
from ros2_mcp.ops.pictures.next_message import next_message
from ros2_mcp.ops.pictures.robot_place import LOCALISED, LOCALISED_TYPE, robot_place
from ros2_mcp.ops.results.results import silent
from ros2_mcp.ops.sources.from_before import from_before
from ros2_mcp.ops.sources.source import GraphSnapshot, Source
from ros2_mcp.ops.space.body import NO_MOUNT, MountInWords, footprint_in_words, mounted
from ros2_mcp.ops.space.brief import MOST_BYTES, Part, RobotInBrief, one_part, within
from ros2_mcp.ops.space.controllers import LIST_CONTROLLERS, Controller, controllers_of, idle_movers, listed_controllers
from ros2_mcp.ops.space.description import described
from ros2_mcp.ops.space.edges import edge_row, in_words
from ros2_mcp.ops.space.first_heard import FIRST_S, YOUNG_S, frames_heard, not_heard_in_words
from ros2_mcp.ops.space.frames import MAP, WORLDS, disputed_roots, frames_of, separate_roots
from ros2_mcp.ops.space.heads import Head, heads_of
from ros2_mcp.ops.space.inputs import (
    CommandInput,
    command_inputs,
    drive_types,
    orders_by_service,
    other_actions,
    topics_without_publisher,
)
from ros2_mcp.ops.space.joints import JointNow, joints_now, placed
from ros2_mcp.ops.space.lines import Named
from ros2_mcp.ops.space.place import Odometer, now_ns_of, place_in_words
from ros2_mcp.ops.space.sensors import (
    JOINT_STATE,
    MISSED,
    ODOMETRY,
    charge_of,
    ranked,
    rate_in_words,
    sees_in_words,
    sensors_of,
    state_topics,
    view_in_words,
)
from ros2_mcp.ops.space.stacks import idle_servers, nav2_active, stacks_of, with_active
from ros2_mcp.ops.space.standing_time import standing_time
from ros2_mcp.ops.space.states import states_of
from ros2_mcp.robot import Robot
from ros2_mcp.robot.transforms import LISTENS
from ros2_mcp.world.robot_kind import arms_of, kind_of, wheels_of
from ros2_mcp.world.transforms import FrameTree
from ros2_mcp.world.urdf import Urdf, parse
from ros2_mcp_common.finite import not_finite
from ros2_mcp_common.language.scans import no_bearings

_ANSWERED_S, _GIVEN_UP_S = 1.4, 1.7
"""Limits in s after the call: for the wait for messages, all at the same time, and for each part as a whole. The result
is due within two seconds, with a margin for a busy machine."""
_TURNS_NS = 150_000_000
"""Time after the first joint states in which the states of other joints arrive: drivers that alternate publish at 10 Hz
or more.
"""
_JOINTS_NS = 1_000_000_000
"""The part at the end of a recording in which joint states are read."""
_LEAST_S = 0.4
"""The least wait for messages, however long the graph took: most topics of 2 Hz are then received too."""
_TF = "tf2_msgs/msg/TFMessage"
_BATTERY = "sensor_msgs/msg/BatteryState"
_IMAGE, _CAMERA = "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo"
_MOST_RANGES, _MOST_CAMERAS = 8, 16
_WITH_RANGE = ("sensor_msgs/msg/LaserScan", "sensor_msgs/msg/Range")
_MOST_SENSORS, _MOST_STATES = 30, 20
"""Limits of sensors whose rate and frame, and of states whose value, are read for the brief answer: 4 kB have hardly
room for more."""
_MOST_HEARD = 40
"""Limit of sensors whose rate and frame are read for the full answer."""
_FIRST = ("frames", "odometry", "diagnostics")
"""Parts for which a bridge that has just started waits for a first message."""
_MOST_CORNERS = 200
"""Limit of the corners of a footprint: more are a mistake."""
_NOTHING_REPORTS = "Nothing reports the position of"
_NO_DESCRIPTION = "No description (URDF) was found: kind, size and joints are guessed or unknown."
_logger = logging.getLogger(__name__)


@dataclass(slots=True)
class _Seen:
    """The information gathered so far; None or empty if not received. `senseless` lists topics with invalid values;
    `ages` says, by topic, that a message was sent before the subscription began.
    """

    graph: GraphSnapshot
    most_sensors: int
    urdf: Urdf | None = None
    tree: FrameTree = field(default_factory=FrameTree)
    heads: Mapping[str, Head] = field(default_factory=dict[str, Head])
    ranges: dict[str, str] = field(default_factory=dict[str, str])
    views: dict[str, str] = field(default_factory=dict[str, str])
    positions: dict[str, float] = field(default_factory=dict[str, float])
    ages: dict[str, str] = field(default_factory=dict[str, str])
    batteries: dict[str, float | None] = field(default_factory=dict[str, "float | None"])
    footprint: Sequence[tuple[float, float, float]] = ()
    footprint_frame: str = ""
    managed: Mapping[str, Sequence[Mapping[str, Any]]] = field(default_factory=dict[str, Sequence[Mapping[str, Any]]])
    nav2: str = ""
    reports: list[str] = field(default_factory=list[str])
    rates: Mapping[str, str] = field(default_factory=dict[str, str])
    states: Mapping[str, str] = field(default_factory=dict[str, str])
    faults: Sequence[str] = ()
    senseless: list[str] = field(default_factory=list[str])
    odometry: Any = None
    odometry_topic: str = ""
    in_map: RobotPlace | None = None
    diagnostics_topic: str = ""
    has_diagnostics: bool = False
    problems: list[str] = field(default_factory=list[str])
    not_read: list[str] = field(default_factory=list[str])
    stands: str = ""
    asked_at: float = field(default_factory=monotonic)
    listened_at: float = field(default_factory=monotonic)
    waits_until: float = 0.0

    @property
    def listen_s(self) -> float:
        """The remaining time to wait for messages, in s."""
        return max(self.asked_at + _ANSWERED_S - monotonic(), _LEAST_S)

    @property
    def first_s(self) -> float:
        """The remaining time to wait for the first message of frames, odometry and diagnostics, in s."""
        return max(self.waits_until - monotonic(), self.listen_s)


async def in_brief(robot: Robot, source: Source, *, part: Part = "", whole: bool = False) -> RobotInBrief:
    """Return the description of the robot from URDF, transforms, graph and sensors: within 4 kB, or one `part` of it in
    full, or the `whole`.

    Raises:
        NotFound: if no node is found.
        LinkError: if there is no bridge.
    """
    seen = await _gathered(robot, source, _MOST_HEARD if whole or part == "sensors" else _MOST_SENSORS)
    everything = _everything(source, seen)
    if part:
        return one_part(everything, part)
    return everything if whole else await asyncio.to_thread(within, everything, MOST_BYTES)


async def unhealthy_besides(robot: Robot, source: Source) -> Sequence[str]:
    """Return the faults that `in_brief` calls unhealthy, in sentences, without the faults that a health check finds
    itself: frames, silent topics, diagnostics, controllers. Raises as `in_brief`.
    """
    seen = await _gathered(robot, source, _MOST_SENSORS)
    unsure = "" if seen.tree.frames else _NO_DESCRIPTION  # without frames it may be no robot, and needs no description
    is_heard = seen.positions or not _topics(seen.graph, JOINT_STATE)
    beside = () if is_heard else (_NOTHING_REPORTS,)  # the silent topic is reported already
    return [each for each in _of_the_robot(seen) if each != unsure and not each.startswith(beside)]


async def _gathered(robot: Robot, source: Source, most_sensors: int) -> _Seen:
    asked_at = monotonic()
    is_young = source.is_live and robot.graph.bridge_age_s < YOUNG_S
    await load("ros2_mcp.values.cdr", "ros2_mcp.values.select")  # with numpy: not before it is needed
    graph = await source.graph()
    if graph.absence:
        raise NotFound(graph.absence, "ros2_status shows domain and middleware.")
    seen = _Seen(graph, most_sensors=most_sensors, asked_at=asked_at)
    given_up_at = max(asked_at + _GIVEN_UP_S, monotonic() + _LEAST_S) if source.is_live else math.inf
    if is_young:
        seen.waits_until = seen.listened_at + FIRST_S
    first_given_up_at = max(given_up_at, seen.waits_until + _GIVEN_UP_S - _ANSWERED_S)
    gathering = (
        ("description", _description(robot, source, seen)),
        ("frames", _frames(source, seen)),
        ("rates of the sensors", _heads(robot, source, seen)),
        ("ranges of the sensors", _ranges(source, seen)),
        ("views of the cameras", _views(source, seen)),
        ("positions of the joints", _joint_states(source, seen)),
        ("batteries", _batteries(source, seen)),
        ("diagnostics", _reports(source, seen)),
        ("states", _states(source, seen)),
        ("odometry", _odometry(source, seen)),
        ("place in the map", _in_map(source, seen)),
        ("footprint", _published_footprint(source, seen)),
        ("controllers", _managed(robot, source, seen)),
    )
    ends = {what: first_given_up_at if what in _FIRST else given_up_at for what, _ in gathering}
    await asyncio.gather(*(_safely(seen, what, work, ends[what]) for what, work in gathering))
    if source.is_live:
        _note_not_heard(seen)
    return seen


# ── gathering ────────────────────────────────────────────────────────────────────────────────────────────────────────


async def _safely(seen: _Seen, what: str, work: Awaitable[None], given_up_at: float) -> None:
    """Gather one part; if it fails or takes too long, report that without affecting the other parts."""
    try:
        with anyio.move_on_after(given_up_at - monotonic()) as scope:
            await work
        if scope.cancelled_caught:
            seen.not_read.append(what)
    except Exception as error:
        _logger.warning("%s could not be read", what, exc_info=True)
        seen.problems.append(f"The {what} could not be read: {quoted(str(error)[:120])}.")


def _topics(graph: GraphSnapshot, *types: str) -> list[TopicEndpoints]:
    """Return the topics of these types that have a publisher, sorted by name."""
    found = [one for one in graph.topics.values() if one.publishers and set(one.types) & set(types)]
    return sorted(found, key=lambda one: one.topic)


def _note_not_heard(seen: _Seen) -> None:
    """Report topics that are published but were silent, instead of their parts as not read."""
    waited_s = monotonic() - seen.listened_at
    silent_parts = {
        "frames": [] if seen.tree.frames else [one.topic for one in _topics(seen.graph, _TF)],
        "odometry": [seen.odometry_topic] if seen.odometry_topic and seen.odometry is None else [],
        "diagnostics": [seen.diagnostics_topic] if seen.diagnostics_topic and not seen.has_diagnostics else [],
    }
    for part, topics in silent_parts.items():
        if topics:
            seen.not_read = [one for one in seen.not_read if one != part]
            seen.not_read.append(not_heard_in_words(part, topics, waited_s))


async def _message(source: Source, seen: _Seen, topic: str, type_name: str, listen_s: float | None = None) -> Any:
    """Return the next message of a topic; None if none is received."""
    with suppress(RobotError):
        lasting = source.lasting(seen.listen_s if listen_s is None else listen_s)
        found = await next_message(lasting, topic, type_name, silent)
        seen.ages[topic] = found.age
        return found.message
    return None


async def _description(robot: Robot, source: Source, seen: _Seen) -> None:
    kind = "std_msgs/msg/String"
    for topic in (one.topic for one in _topics(seen.graph, kind)):
        if topic.rpartition("/")[2] == "robot_description" and (said := await _message(source, seen, topic, kind)):
            try:
                seen.urdf = await asyncio.to_thread(parse, said.data)
            except RobotError as error:
                seen.problems.append(f"{named(topic)}: {error.message}")
            return
    if source.is_live:  # state publishers of older distributions have it only as a parameter
        with suppress(RobotError, asyncio.TimeoutError):
            seen.urdf = await asyncio.wait_for(described(robot), seen.listen_s)


async def _frames(source: Source, seen: _Seen) -> None:
    def is_whole(tree: FrameTree) -> bool:
        return bool(tree.base) and tree.root_of(tree.base).rpartition("/")[2] == "map"

    with suppress(RobotError):
        topics = seen.graph.topics
        if source.transforms and not any(topics[name].publishers for name in LISTENS if name in topics):
            await source.transforms.moved()  # at once: the graph has settled, and frames_of would wait for /tf first
        if source.transforms:  # the same tree grows while waiting, so that a time-out keeps what was received
            seen.tree = await source.transforms.listening()
            published = [one.topic for one in _topics(seen.graph, _TF)]
            await frames_heard(source.transforms, published, seen.waits_until)
        seen.tree = await frames_of(source, until=is_whole, patience_s=seen.listen_s)
        seen.stands = await standing_time(source, seen.tree, now_ns_of(source))


async def _heads(robot: Robot, source: Source, seen: _Seen) -> None:
    sensors = [one.topic for one, _ in ranked(seen.graph)][: seen.most_sensors]
    others = [topic for topic, _ in state_topics(seen.graph)][:_MOST_STATES]
    others += [one.topic for one in _topics(seen.graph, _BATTERY)[:2]]
    heads = await heads_of(robot, source, [*sensors, *others], seen.listen_s)
    seen.heads = {topic: head for topic, head in heads.items() if topic in sensors}
    seen.rates = {topic: rate_in_words(heads[topic]) for topic in others if topic in heads}


async def _ranges(source: Source, seen: _Seen) -> None:
    """Read the ranges of distance sensors, and the angle that a scanner covers."""
    topics = _topics(seen.graph, *_WITH_RANGE)[:_MOST_RANGES]
    kinds = [next(kind for kind in one.types if kind in _WITH_RANGE) for one in topics]
    found = await asyncio.gather(
        *(_message(source, seen, one.topic, kind) for one, kind in zip(topics, kinds, strict=True))
    )
    for one, message in zip(topics, found, strict=True):
        if message is None:
            continue
        seen.ranges[one.topic] = sees_in_words(message)
        if hasattr(message, "ranges") and (why := no_bearings(message)):
            seen.senseless.append(f"{named(one.topic)} has no bearings: {why}.")


async def _views(source: Source, seen: _Seen) -> None:
    """Read the horizontal field of view of cameras, from the CameraInfo published beside their images."""
    cameras: dict[str, str] = {}
    for one, kind in ranked(seen.graph)[: seen.most_sensors]:
        told = f"{one.topic.rpartition('/')[0]}/camera_info"
        if kind == _IMAGE and told in seen.graph.topics and len(cameras) < _MOST_CAMERAS:
            cameras[one.topic] = told
    found = await asyncio.gather(*(_message(source, seen, told, _CAMERA) for told in cameras.values()))
    for topic, message in zip(cameras, found, strict=True):
        if message is not None:
            seen.views[topic] = view_in_words(message)


async def _joint_states(source: Source, seen: _Seen) -> None:
    """Read the joint positions. Only topics named joint_states are read if there are any: some drivers publish limits
    as JointState on other topics. Others alternate the joints of base and arm on one topic.
    """
    topics = [one.topic for one in _topics(seen.graph, JOINT_STATE)]
    usual = [topic for topic in topics if topic.rpartition("/")[2] == "joint_states"]
    await asyncio.gather(*(_positions(source, seen, topic) for topic in (usual or topics)[:3]))


async def _positions(source: Source, seen: _Seen, topic: str) -> None:
    if source.is_live:
        part = source.lasting(seen.listen_s)
    else:
        end_ns = source.covers_ns[1] if source.covers_ns else 0
        part = source.part(end_ns - _JOINTS_NS, end_ns) if end_ns else source
    with suppress(RobotError):
        async with part.follow(topic) as stream:
            first_ns: int | None = None
            async for batch in stream.batches:
                for sample in batch:
                    first_ns = sample.received_ns if first_ns is None else first_ns
                    message: Any = stream.codec.decode(stream.type, sample.data)
                    told = zip(message.name, message.position, strict=False)
                    seen.positions |= {name: float(at) for name, at in told}
                    seen.ages[topic] = from_before(source, stream, [sample]).age
                    if sample.received_ns - first_ns > _TURNS_NS and source.is_live:
                        return


async def _batteries(source: Source, seen: _Seen) -> None:
    """Read the charge of each battery, from 0 to 1; None if it is not reported or no message was received."""
    topics = _topics(seen.graph, _BATTERY)[:2]
    found = await asyncio.gather(*(_message(source, seen, one.topic, _BATTERY) for one in topics))
    for one, message in zip(topics, found, strict=True):
        seen.batteries[one.topic] = None if message is None else charge_of(message)


async def _reports(source: Source, seen: _Seen) -> None:
    """Read the diagnostics that are not OK."""
    kind = "diagnostic_msgs/msg/DiagnosticArray"
    worst: dict[str, tuple[str, str]] = {}
    for one in _topics(seen.graph, kind)[:1]:
        seen.diagnostics_topic = one.topic
        with suppress(RobotError), anyio.CancelScope() as listening:
            async with source.lasting(seen.first_s).follow(one.topic, limit=20) as stream:
                async for batch in stream.batches:
                    if batch and source.is_live and not seen.has_diagnostics:  # further ones have the usual time
                        listening.deadline = anyio.current_time() + seen.listen_s
                    seen.has_diagnostics |= bool(batch)
                    for sample in batch:
                        message: Any = stream.codec.decode(stream.type, sample.data)
                        for status in message.status:
                            level = LEVELS[int(status.level)] if int(status.level) < len(LEVELS) else str(status.level)
                            worst[status.name] = level, " ".join(status.message.split())
                            seen.ages[status.name] = from_before(source, stream, [sample]).age
    told = {name: (level, said) for name, (level, said) in worst.items() if level != "OK"}
    summed_up = {name for name, (level, said) in told.items() if said == level}
    if len(summed_up) < len(told):  # a status that only summarises others adds nothing
        told = {name: said for name, said in told.items() if name not in summed_up}
    ages = {name: f" ({seen.ages[name]})" if seen.ages[name] else "" for name in told}
    seen.reports = [f"{level} {quoted(name)}: {quoted(said)}{ages[name]}" for name, (level, said) in told.items()]


async def _states(source: Source, seen: _Seen) -> None:
    """Read the modes, flags and numbers that the robot publishes on topics of one value each."""
    topics = [one for one in state_topics(seen.graph) if one[1] not in (ODOMETRY, JOINT_STATE)][:_MOST_STATES]
    seen.states, seen.faults = await states_of(source.lasting(seen.listen_s), dict(topics))


async def _odometry(source: Source, seen: _Seen) -> None:
    found = [one.topic for one in _topics(seen.graph, ODOMETRY)]
    found.sort(key=lambda name: ("filtered" not in name, name.rpartition("/")[2] != "odom", name))  # the best first
    for topic in found[:1]:
        seen.odometry_topic = topic
        seen.odometry = await _message(source, seen, topic, ODOMETRY, seen.first_s)


async def _in_map(source: Source, seen: _Seen) -> None:
    """Read the robot's pose in the map as pictures show it: from TF, else from a localisation topic."""
    if any(one.topic in LOCALISED for one in _topics(seen.graph, LOCALISED_TYPE)):
        seen.in_map = await robot_place(source, MAP)


async def _published_footprint(source: Source, seen: _Seen) -> None:
    """Read the footprint that Nav2 publishes, in whatever frame."""
    for one in _topics(seen.graph, "geometry_msgs/msg/PolygonStamped"):
        if "footprint" not in one.topic:
            continue
        if message := await _message(source, seen, one.topic, "geometry_msgs/msg/PolygonStamped"):
            if why := not_finite(message, "polygon"):
                seen.senseless.append(f"{named(one.topic)} is not a valid footprint: {why}.")
                return
            seen.footprint = [(float(at.x), float(at.y), float(at.z)) for at in message.polygon.points[:_MOST_CORNERS]]
            seen.footprint_frame = message.header.frame_id.lstrip("/")
            return


async def _managed(robot: Robot, source: Source, seen: _Seen) -> None:
    seen.nav2 = await nav2_active(robot, source, seen.graph)
    if source.is_live:
        try:
            seen.managed = await listed_controllers(robot, seen.graph)
        except UnknownInterface:
            seen.not_read.append("controllers (controller_manager_msgs is not installed where the bridge runs)")
            return
        if not seen.managed and any(name.endswith(LIST_CONTROLLERS) for name in seen.graph.services or ()):
            seen.not_read.append("controllers")


# ── composing ────────────────────────────────────────────────────────────────────────────────────────────────────────


def _everything(source: Source, seen: _Seen) -> RobotInBrief:
    base = _base_of(seen)
    inputs = command_inputs(seen.graph, seen.managed)
    waited = topics_without_publisher(seen.graph, inputs)
    asked = {*(one.topic for one in inputs), *(one.name for one in waited)}
    told = [
        Named(name, kind.rpartition("/")[2], seen.states.get(name) or seen.rates.get(name, ""))
        for name, kind in state_topics(seen.graph)
        if name not in asked
    ]
    stacks = stacks_of(seen.graph)
    is_silent = source.is_live and bool(seen.odometry_topic)
    is_unread = _misses_frames(seen) or is_silent or "odometry" in seen.not_read
    odometer = Odometer(seen.odometry_topic, seen.odometry, seen.ages.get(seen.odometry_topic, ""))
    place, trouble = place_in_words(
        source, seen.tree, base, odometer, seen.urdf, in_map=seen.in_map, is_unread=is_unread
    )
    return RobotInBrief(
        name=(seen.urdf.name if seen.urdf else "") or "robot",
        kind=kind_of(seen.urdf, drive_types(inputs), stacks, _controller_types(seen)),
        base_frame=base,
        footprint=footprint_in_words(seen.urdf, seen.tree, base, seen.footprint, seen.footprint_frame),
        place=place,
        frames=_frames_in_words(seen, base),
        stacks=with_active(stacks, seen.nav2),
        unhealthy=[*trouble, *_old_positions(seen), *_unhealthy(source, seen), *idle_servers(seen.nav2)],
        command_inputs=_lines(inputs),
        other_actions=_lines(other_actions(seen.graph, inputs)),
        topics_without_publisher=_lines(waited),
        command_services=_lines(orders_by_service(seen.graph)),
        sensors=_sensors(seen, base),
        state_topics=_lines(told),
        joints=_lines(joints_now(seen.urdf, seen.positions, " ".join(seen.reports))),
        controllers=_lines(controllers_of(seen.graph, seen.managed, is_controlled="ros2_control" in stacks)),
        not_read=seen.not_read or None,
        read_from=None if source.is_live else source.words,
    )


def _lines(things: Iterable[CommandInput | Named | JointNow | Controller]) -> list[str]:
    return [one.line for one in things]


def _controller_types(seen: _Seen) -> list[str]:
    """Return the types of the active controllers, as reported by controller managers."""
    return [str(one["type"]) for all_of in seen.managed.values() for one in all_of if one["state"] == "active"]


def _base_of(seen: _Seen) -> str:
    """Return the frame of the robot's body: the base of the frame tree, else of the URDF."""
    if seen.tree.base:
        return seen.tree.base
    if seen.urdf is None:
        return ""
    root = next((name for name in ("base_link", "base_footprint") if name in seen.urdf.links), seen.urdf.root)
    arms = arms_of(seen.urdf) if root.lower() in WORLDS else []
    return arms[0][0].parent if arms else root


def _sensors(seen: _Seen, base: str) -> list[str]:
    frames = {head.frame for head in seen.heads.values() if head.frame}
    mounts = {frame: _mounted(seen, base, frame) for frame in frames}
    batteries = {
        topic: ", ".join(
            filter(None, ("" if share is None else f"{share:.0%}", seen.ages.get(topic), seen.rates.get(topic)))
        )
        for topic, share in seen.batteries.items()
    }
    return [one.line for one in sensors_of(seen.graph, seen.heads, mounts, seen.ranges, batteries, seen.views)]


def _mounted(seen: _Seen, base: str, frame: str) -> MountInWords:
    cameras = (one.topic for one, kind in ranked(seen.graph) if kind == _IMAGE)
    is_camera = any(seen.heads[topic].frame == frame for topic in cameras if topic in seen.heads)
    return mounted(seen.urdf, seen.tree, base, frame, seen.positions, is_camera=is_camera)


def _frames_in_words(seen: _Seen, base: str) -> str:
    tree = seen.tree
    if not tree.frames:
        return "not read" if _misses_frames(seen) else "none"
    chain = [base, *(edge.newest.parent for edge in tree.way_up(base) if edge.newest)] if base in tree.frames else []
    way = f"{' → '.join(map(named, reversed(chain)))}; " if len(chain) > 1 else ""
    roots = separate_roots(tree)
    trees = f", {len(roots)} trees" if len(roots) > 1 else ""
    apart = [root for root in tree.roots if root not in roots and root not in disputed_roots(tree)]
    copies = f" ({', '.join(map(named, apart))} with its copies apart)" if apart else ""
    return f"{way}{len(tree.frames)} frames in total{trees}{copies}"


def _misses_frames(seen: _Seen) -> bool:
    """Return whether this call received no transform although /tf or /tf_static has a publisher."""
    return not seen.tree.frames and ("frames" in seen.not_read or bool(_topics(seen.graph, _TF)))


def _old_positions(seen: _Seen) -> list[str]:
    topics = [one.topic for one in _topics(seen.graph, JOINT_STATE) if seen.ages.get(one.topic)]
    return [f"The joint positions of {named(topic)} are {seen.ages[topic]}." for topic in topics]


def _unhealthy(source: Source, seen: _Seen) -> list[str]:
    found = [*seen.problems, *filter(None, [seen.stands])]
    if len(roots := separate_roots(seen.tree)) > 1:
        found.append(f"{len(roots)} trees of frames: {', '.join(map(named, roots[:4]))}.")
    now_ns = now_ns_of(source)
    for edge in seen.tree.edges.values():
        row = edge_row(seen.tree, edge, now_ns or edge.last_received_ns, time_stands=bool(seen.stands))
        if row.problem:
            found.append(in_words(row))
    missed = {one.topic for one, kind in ranked(seen.graph) if kind in MISSED}
    silent_ones = (topic for topic, head in seen.heads.items() if not head.count and topic in missed)
    found += [f"{named(topic)} has a publisher, but no message was received." for topic in silent_ones]
    return [*found, *_of_the_robot(seen), *idle_movers(seen.graph, seen.managed), *seen.reports]


def _of_the_robot(seen: _Seen) -> list[str]:
    """Return the problems of description, joints, batteries, mounts and localisation, and the faults that the robot
    reports.
    """
    found: list[str] = []
    if seen.urdf:
        found += seen.urdf.problems[:2]
        wheels = {joint.name for joint in wheels_of(seen.urdf)}
        unknown = [
            one.name
            for one in placed(seen.urdf, seen.positions)
            if one.name not in seen.positions and (one.kind != "continuous" or one.name in wheels)
        ]
        if unknown and "positions of the joints" not in seen.not_read:
            more = f" and {len(unknown) - 3} more" if len(unknown) > 3 else ""
            found.append(f"{_NOTHING_REPORTS} {', '.join(map(named, unknown[:3]))}{more}.")
    elif not seen.problems and "description" not in seen.not_read:
        found.append(_NO_DESCRIPTION)
    low = [(share, topic) for topic, share in seen.batteries.items() if share is not None and share < 0.2]
    if low:
        share, topic = min(low)
        age = f" ({seen.ages[topic]})" if seen.ages.get(topic) else ""
        found.append(f"The battery is at {share:.0%}{age}.")
    base = _base_of(seen)
    frames = dict.fromkeys(head.frame for head in seen.heads.values() if head.frame and seen.tree.frames)
    found += [f"Not in TF: {named(frame)}." for frame in frames if _mounted(seen, base, frame) == NO_MOUNT]
    return [*found, *seen.senseless, *seen.faults, *filter(None, [_not_localised(seen)])]


def _not_localised(seen: _Seen) -> str:
    """Report that a localisation node runs but the robot's pose in the map is not published; else empty."""
    localisers = [name for name in seen.graph.nodes or () if name.rpartition("/")[2] in ("amcl", "slam_toolbox")]
    maps = [name for name in seen.tree.frames if name.rpartition("/")[2] == "map"]
    is_told = any(seen.tree.newest(frame, seen.tree.base) for frame in maps) if seen.tree.base else False
    if not localisers or is_told or seen.in_map or not seen.tree.base:
        return ""
    return f"Not localised: {named(localisers[0])} runs, but nothing reports where the robot is in the map."
