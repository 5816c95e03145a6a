"""The collision monitor: it stops the robot because of an obstacle, or of a source that is late or missing."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

from ros2_mcp.model.text import named
from ros2_mcp.ops.navigation.checks.check import CHAIN, NavCheck
from ros2_mcp.ops.navigation.evidence import (
    SCAN,
    SENSORS,
    Frames,
    NavEvidence,
    NavFinding,
    is_zero,
    resolved,
    said,
    speed_of,
)
from ros2_mcp_common.policy.polygons import is_inside

_STATE = "nav2_msgs/msg/CollisionMonitorState"
INVALID_SOURCE = "invalid source"
"""The polygon that a collision monitor names when it stops the robot because a source has no valid data."""
_NO_DATA = r"stop due to invalid source|timestamps differ on|source .*detected"
"""What a collision monitor logs of a source without valid data."""
_ACTIONS = ("nothing", "stop", "slowdown", "approach", "limit")
_SOURCE_TIMEOUT_S = 2.0
"""Nav2's default."""
_LEAST_POINTS = 4
_LEAST_COMMANDS, _HELD_NS, _PASSES_NOTHING = 5, 1_000_000_000, 0.01
"""Commands that come, the time over which they do, and the speed in m/s or rad/s below which nothing is passed on."""
_MOST_NAMES = 4


@dataclass(frozen=True, slots=True, order=True)
class Near:
    """A point that a sensor sees: its distance from the base in m, and its bearing in degrees, positive to the left."""

    away_m: float
    bearing_deg: float

    def __str__(self) -> str:
        return f"{self.away_m:.2f} m, bearing {self.bearing_deg:.0f}° (left is positive)"


def _find(evidence: NavEvidence) -> Iterator[NavFinding]:
    for node in evidence.of_role("collision_monitor"):
        values = (evidence.parameters or {}).get(node, {})
        topics = _as_remapped(evidence, node, sources_of(node, values))
        missing = list(_sources(evidence, node, values, topics))
        yield from missing or _held(evidence, node, values, list(topics.values()))


def sources_of(node: str, values: Mapping[str, Any]) -> dict[str, str]:
    """Return the sources of a collision monitor with their topics, by its parameters."""
    sources = _texts(values.get("observation_sources"))
    return {source: resolved(node, str(values.get(f"{source}.topic", "") or f"/{source}")) for source in sources}


def _as_remapped(evidence: NavEvidence, node: str, topics: Mapping[str, str]) -> dict[str, str]:
    """Return the sources with the topics that the node really subscribes to: a launch file may remap them."""
    heard = [topic.topic for topic in evidence.topics(*SENSORS) if any(one.node == node for one in topic.subscribers)]
    others = [topic for topic in heard if topic not in topics.values()]
    absent = [source for source, topic in topics.items() if topic not in heard]
    if len(absent) != 1 or len(others) != 1:
        return dict(topics)
    return {**topics, absent[0]: others[0]}


def _sources(
    evidence: NavEvidence, node: str, values: Mapping[str, Any], topics: Mapping[str, str]
) -> Iterator[NavFinding]:
    """Find enabled sources without data: the collision monitor stops the robot until they publish."""
    for source, topic in topics.items():
        if values.get(f"{source}.enabled") is False:
            continue
        limit = values.get(f"{source}.source_timeout", values.get("source_timeout", _SOURCE_TIMEOUT_S))
        limit_s = float(limit) if isinstance(limit, (int, float)) else _SOURCE_TIMEOUT_S
        heard = (evidence.heard or {}).get(topic)
        is_old = bool(limit_s and heard and heard.ages_s and min(heard.ages_s) > limit_s)
        if not evidence.topic(topic).publishers:
            cause = f"{named(node)} holds the robot: its source {named(source)} has no publisher."
            proof = f"Nobody publishes {named(topic)}; source_timeout is {limit_s:g} s."
        elif heard and is_old:
            cause = f"{named(node)} holds the robot: its source {named(source)} is older than it allows."
            proof = f"{named(topic)} is {min(heard.ages_s):.2f} s old when it comes; source_timeout is {limit_s:g} s."
        elif limit_s and heard and heard.count and heard.longest_gap_s > limit_s:
            cause = f"{named(node)} stops the robot again and again: its source {named(source)} comes too seldom."
            proof = (
                f"On {named(topic)}, no message came for {heard.longest_gap_s:.1f} s; source_timeout is {limit_s:g} s."
            )
        else:
            continue
        yield NavFinding(
            rank="stops everything",
            subject=topic if is_old else node,  # old only because clocks differ, where that is found
            cause=cause,
            proof=proof,
            remedy=f"Start what publishes {named(topic)}, correct {source}.topic, or take the source out.",
            covers=(topic,),
        )


def _held(evidence: NavEvidence, node: str, values: Mapping[str, Any], topics: Sequence[str]) -> Iterator[NavFinding]:
    state = next((one.newest for one in evidence.of(_STATE) if node in one.nodes and one.newest is not None), None)
    without_data = [line for line in evidence.lines(_NO_DATA, "collision_monitor") if line.node == node]
    faults = _without_data(evidence, values, topics)
    # The state is published when it changes, and so mostly before anybody listens; the log is kept.
    says_so = str(state.polygon_name) == INVALID_SOURCE if state is not None else bool(without_data and faults)
    if says_so:
        yield NavFinding(
            rank="stops everything",
            subject=node,
            cause=f"{named(node)} holds the robot: {_either(faults) or 'a source of it gives no valid data'}.",
            proof=" ".join(
                [
                    *([f"collision_monitor_state: stop, {INVALID_SOURCE}."] if state is not None else []),
                    *([f"{said(without_data[-1])}."] if without_data else []),
                    *_ages(evidence, topics),
                ]
            ),
            remedy="Start what publishes that source, or its transform to the base; or set source_timeout to what it "
            "needs.",
        )
        return
    action = int(state.action_type) if state is not None else 0
    if state is not None and (action == 1 or (action and _holds_back(evidence, node, values))):
        name = str(state.polygon_name)
        near = _in_polygon(evidence, values, name, topics)
        yield _holding(evidence, node, name, _ACTIONS[action], near)
        return
    if state is not None:
        return
    for name, least in stop_polygons(values):
        points = _in_polygon(evidence, values, name, topics)
        if len(points) >= least:
            yield _holding(evidence, node, name, "stop", points)


def stop_polygons(values: Mapping[str, Any]) -> Iterator[tuple[str, int]]:
    """Return the enabled polygons and circles that stop the robot, by a collision monitor's parameters, each with the
    number of points that it takes."""
    for name in _texts(values.get("polygons")):
        if str(values.get(f"{name}.action_type", "")).lower() != "stop" or values.get(f"{name}.enabled") is False:
            continue
        least = values.get(f"{name}.min_points", values.get(f"{name}.max_points", _LEAST_POINTS))
        yield name, int(least) if isinstance(least, (int, float)) else _LEAST_POINTS


def _holds_back(evidence: NavEvidence, node: str, values: Mapping[str, Any]) -> bool:
    """Return whether a collision monitor lets no motion through although commands arrive. Its actions other than "stop"
    only slow the robot, but near an obstacle they, too, bring it to a stop.
    """
    ends = (("cmd_vel_in_topic", "cmd_vel_smoothed"), ("cmd_vel_out_topic", "cmd_vel"))
    came, went = (
        (evidence.heard or {}).get(resolved(node, str(values.get(name) or default))) for name, default in ends
    )
    if came is None or went is None:
        return False
    asked = [received_ns for received_ns, message, _ in came.messages if not is_zero(message)]
    if len(asked) < _LEAST_COMMANDS or asked[-1] - asked[0] < _HELD_NS:
        return False
    passed = [message for received_ns, message, _ in went.messages if received_ns >= asked[0]]
    return bool(passed) and all(max(map(abs, speed_of(message))) < _PASSES_NOTHING for message in passed)


def _without_data(evidence: NavEvidence, values: Mapping[str, Any], topics: Sequence[str]) -> list[str]:
    """Return what is wrong now with each source that gives no data: silent, or without a transform to the base."""
    frames, faults = evidence.frames, list[str]()
    base = base_of_monitor(values) or (frames.tree.base if frames else "")
    for topic in topics:
        heard = (evidence.heard or {}).get(topic)
        if heard is None:
            continue
        if heard.is_silent:
            faults.append(f"its source {named(topic)} is silent")
        elif frames and base and heard.frame_id and frames.tree.newest(base, heard.frame_id) is None:
            faults.append(f"its source {named(topic)} has no transform from {named(heard.frame_id)} to {named(base)}")
    return faults


def _either(faults: Sequence[str]) -> str:
    return "; ".join(faults[:_MOST_NAMES])


def _ages(evidence: NavEvidence, topics: Sequence[str]) -> Iterator[str]:
    """Describe how old each source is."""
    for topic in topics[:_MOST_NAMES]:
        heard = (evidence.heard or {}).get(topic)
        if heard is None:
            yield f"{named(topic)} was not listened to."
        elif not heard.count:
            yield f"Nothing came on {named(topic)} in {heard.duration_s:.1f} s."
        else:
            age = f", up to {max(heard.ages_s):.2f} s old when it comes" if heard.ages_s else ""
            yield f"{named(topic)} comes with {heard.rate_hz:.3g} Hz{age}."


def _holding(evidence: NavEvidence, node: str, name: str, action: str, points: Sequence[Near]) -> NavFinding:
    proof, blind = [f"collision_monitor_state: {action}, {named(name)}." if not points else ""], ""
    if points:
        proof = [f"{len(points)} points of the scan are in {named(name)}, the nearest at {points[0]}."]
    for costmap in evidence.of_role("local_costmap"):
        for parameter, value in (evidence.parameters or {}).get(costmap, {}).items():
            is_blind = parameter.endswith("obstacle_min_range") and isinstance(value, (int, float)) and value > 0
            if is_blind and (not points or points[0].away_m < float(value)):
                proof.append(f"The costmap ignores all below {float(value):g} m ({parameter}), and plans through it.")
                blind = f" Lower {parameter}, so that Nav2 plans around it."
    return NavFinding(
        rank="stops everything",
        subject=node,
        cause=f"{named(node)} holds the robot: its polygon {named(name)} ({action}) is not free.",
        proof=" ".join(filter(None, proof)),
        remedy="Remove what stands there; if that is the robot itself, make the polygon smaller or filter the scan."
        f"{blind}",
    )


def _in_polygon(evidence: NavEvidence, values: Mapping[str, Any], name: str, topics: Sequence[str]) -> list[Near]:
    """Return the scan points inside a polygon or circle, the nearest first."""
    frames = evidence.frames
    base = base_of_monitor(values) or (frames.tree.base if frames else "")
    if not frames or not base:
        return []
    hits: list[tuple[float, float]] = []
    for topic in topics:
        heard = (evidence.heard or {}).get(topic)
        if heard is not None and heard.type == SCAN and heard.messages:
            hits += hits_in(frames, base, heard.messages[-1][1])
    return near_in(values, name, hits)


def base_of_monitor(values: Mapping[str, Any]) -> str:
    """Return the frame in which a collision monitor's polygons are, by its parameters; "" if it is not known."""
    return str(values.get("base_frame_id") or "")


def near_in(values: Mapping[str, Any], name: str, hits: Iterable[tuple[float, float]]) -> list[Near]:
    """Return the points (x and y in m in the base's frame) that are inside a polygon or circle of a collision monitor's
    parameters, the nearest first.
    """
    corners, radius = _corners(values.get(f"{name}.points")), values.get(f"{name}.radius")
    limit_m = float(radius) if isinstance(radius, (int, float)) and not corners else 0.0
    return sorted(
        Near(math.hypot(x, y), math.degrees(math.atan2(y, x)))
        for x, y in hits
        if (math.hypot(x, y) < limit_m if limit_m else bool(corners) and is_inside(x, y, corners))
    )


def hits_in(frames: Frames, base: str, scan: Any) -> list[tuple[float, float]]:
    """Return the end points of a scan's beams that hit something, as x and y in the frame `base`, in m; none without a
    transform."""
    from ros2_mcp.model.errors import BadData
    from ros2_mcp.world.scans import moved, scan_points

    mount = frames.tree.newest(base, str(scan.header.frame_id).lstrip("/"))
    if mount is None:
        return []
    try:
        points = moved(scan_points(scan).hits, mount.pose)
    except BadData:
        return []
    return [(float(x), float(y)) for x, y in points[:, :2].tolist()]


def _corners(value: Any) -> list[tuple[float, float]]:
    """Parse a polygon as Nav2 accepts it: a string with a list of pairs, or (before Jazzy) a flat list of numbers."""
    if isinstance(value, str):
        try:
            read = json.loads(value)
        except ValueError:
            return []
        try:
            return [(float(x), float(y)) for x, y in read]
        except (TypeError, ValueError):
            return []
    if isinstance(value, (list, tuple)):
        numbers = [float(one) for one in cast("Sequence[Any]", value) if isinstance(one, (int, float))]
        return list(zip(numbers[::2], numbers[1::2], strict=False))
    return []


def _texts(value: Any) -> list[str]:
    return [str(one) for one in cast("Sequence[Any]", value)] if isinstance(value, (list, tuple)) else []


CHECK = NavCheck(("parameters", "heard", "frames"), _find, CHAIN)
