"""Find the topics that report the robot's motion, and read them until they show whether it is stationary."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from time import monotonic
from typing import Any, cast

from ros2_mcp.guard.document import ODOMETRY, Feedback
from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.graph import TopicRow
from ros2_mcp.model.samples import Sample
from ros2_mcp.model.text import counted, listed, named
from ros2_mcp.ops.motion.controllers import FOLLOW
from ros2_mcp.ops.motion.joint_states import JOINT_STATE
from ros2_mcp.ops.stop.judge import (
    HOVERING,
    JOINT_WINDOW_S,
    Account,
    BaseJudge,
    Freshness,
    JointJudge,
    Observation,
    Reading,
    Still,
    observation,
)
from ros2_mcp.robot import HOLD_TYPES, VELOCITY_TYPES, Robot
from ros2_mcp.robot.goals import Goal
from ros2_mcp.robot.kept import Kept
from ros2_mcp.robot.seen import is_of_robot

_KINDS: Mapping[str, int] = {ODOMETRY: 4, JOINT_STATE: 8}
"""The types that report motion, and how many topics of each are read: wheel, fused and visual odometry; arms, grippers,
wheels. All of them must show that the robot is stationary."""
_MOST_INPUTS = 5
"""Command topics that are looked up if no topic reports the motion that they cause: a
base, its multiplexer, a servo.
"""
_SETTLED_S = 2.0
"""Time for discovery to settle, which takes about a second after the start of a bridge."""
_FOUND_S = 0.3
"""Time for each further look-up in the graph: the bridge has it at once."""
_FIRST_S = 2.5
"""Time for a first message: publishers are matched in 0.02 to 0.2 s on one host, and report motion at 1 Hz or more."""
_RESTS_S = 1.5
"""Time for joints to come to rest: a hold arrives within tenths of a second, and the arm then brakes."""
_BRAKED_S = 3.0
"""Time to brake from 5 m/s at the 2.5 m/s² at which ArduCopter brakes by default, and a
second until the mode takes effect."""
_BEGINS_S = 0.5
"""Time for subscribing, in addition to the time that the robot has to come to rest."""
_TAKE_S = 0.1
"""The interval at which the time is checked while no message arrives."""
_MESSAGE_BYTES = 1_000_000
"""The most bytes that may be queued: a second of odometry at 1 kHz with its covariances."""
_MOST_NOTED = 1000
"""The most joints of each topic, and the most topics, that are remembered: more than any robot has."""


class _Reported(Kept):
    """The joints that each topic of joint states has reported in this session, so that a joint which is
    no longer reported is noticed.
    """

    def __init__(self) -> None:
        self._joints: dict[str, dict[str, None]] = {}

    def note_joints(self, topic: str, joints: Collection[str]) -> None:
        """Remember that a topic reported these joints."""
        if topic in self._joints or len(self._joints) < _MOST_NOTED:
            known = self._joints.setdefault(topic, {})
            known.update(dict.fromkeys([*joints][: max(0, _MOST_NOTED - len(known))]))

    def joints(self, topic: str) -> Sequence[str]:
        """All joints that the topic has ever reported."""
        return list(self._joints.get(topic, ()))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Source:
    """A topic that reports motion: of joints if `path` is None, else of the base, with its velocity at that field path.
    `most_s` is the time to come to rest, subscribing included.
    """

    topic: str
    type: str
    most_s: float
    path: str | None = None
    still: Still = field(default_factory=Still)


async def observe_still(robot: Robot, *, hovers: bool = False) -> Observation:
    """Read all topics that report motion until they show that the robot is stationary: at most for the time that it has
    to come to rest, or for 2.5 s if a topic shows nothing. Never raises a `RobotError`.

    A vehicle that `hovers` gets time to brake, and may sway in place.
    """
    began_ns = robot.now_ns()
    try:
        sources, missing, unreported = await _sources(robot, hovers)
    except RobotError as error:
        return Observation(verdict="not observed", sentence=f"Not observed: {error}", is_open=True)
    accounts = await asyncio.gather(*(_account(robot, source, began_ns) for source in sources))
    return observation(accounts, missing=missing, unreported=unreported, hovers=hovers)


async def _sources(robot: Robot, hovers: bool) -> tuple[Sequence[_Source], Sequence[str], Sequence[str]]:
    """Return the topics to read; phrases about what should report motion and does not;
    phrases about what no topic reports.
    """
    rows = await robot.graph.topics(_SETTLED_S)
    found = {kind: sorted(row.name for row in rows if kind in row.types and row.publishers) for kind in _KINDS}
    odometry, joint_states = await asyncio.gather(
        *(_published(robot, found[kind][:most], kind) for kind, most in _KINDS.items())
    )
    beyond = [topic for kind, most in _KINDS.items() for topic in found[kind][most:]]
    missing = [] if rows.settled else ["discovery is under way, and more may report motion"]
    missing += [f"{counted(len(beyond), 'more topic')} with odometry or joint states, not read"] if beyond else []
    missing += [
        f"{named(topic)} reported motion before, and has no publisher any more"
        for topic in robot.graph.seen.published(_KINDS)
        if topic not in {*odometry, *joint_states, *beyond}
    ]
    if not joint_states and _has_moved_joints(robot):
        missing.append("no joint states report whether the joints that this server moved have stopped")
    named_ones = [one.feedback for one in robot.policy.documents if one.feedback]
    sources = [_base_source(feedback, hovers=False) for feedback in named_ones]
    sources = sources or [_base_source(Feedback(topic=topic), hovers) for topic in odometry]
    unreported: list[str] = []
    if joint_states and not sources and (inputs := await _subscribed(robot, rows, VELOCITY_TYPES)):
        unreported.append(f"no odometry reports whether the motion commanded on {listed(inputs, 3)} has stopped")
    if sources and not joint_states and (inputs := await _subscribed(robot, rows, HOLD_TYPES)):
        unreported.append(f"no joint states report whether the motion commanded on {listed(inputs, 3)} has stopped")
    rests_s = _RESTS_S + _BEGINS_S + JOINT_WINDOW_S
    sources += [_Source(topic=one, type=JOINT_STATE, most_s=rests_s) for one in joint_states]
    return sources, missing, unreported


def _has_moved_joints(robot: Robot) -> bool:
    return any(driven.type in HOLD_TYPES for driven in robot.failsafes.driven) or any(
        goal.action_type == FOLLOW for goal in robot.jobs.all(Goal)
    )


def _base_source(feedback: Feedback, hovers: bool) -> _Source:
    if hovers:
        still, rests_s = HOVERING, _BRAKED_S
    else:
        linear, angular = (feedback.still.get(part, math.inf) for part in ("linear", "angular"))
        still, rests_s = (
            Still(linear=linear, angular=angular, mean_linear=linear, mean_angular=angular),
            feedback.within_s,
        )
    most_s = rests_s + _BEGINS_S + still.window_s
    return _Source(topic=feedback.topic, type=feedback.type, path=feedback.path, still=still, most_s=most_s)


async def _published(robot: Robot, topics: Sequence[str], kind: str) -> Sequence[str]:
    """Return, sorted, the topics that a node of the robot publishes, and not only this server or another server."""
    found = await asyncio.gather(*(robot.graph.endpoints(topic, _FOUND_S) for topic in topics))
    return sorted(
        present.topic
        for present in found
        if any(one.type == kind and not one.ours and is_of_robot(one.node) for one in present.publishers)
    )


async def _subscribed(robot: Robot, rows: Iterable[TopicRow], kinds: Collection[str]) -> Sequence[str]:
    """Return the command topics of these types to which a node of the robot subscribes."""
    topics = sorted(row.name for row in rows if row.subscribers and not {*kinds}.isdisjoint(row.types))
    found = await asyncio.gather(*(robot.graph.endpoints(topic, _FOUND_S) for topic in topics[:_MOST_INPUTS]))
    return sorted(
        present.topic for present in found if any(not one.ours and is_of_robot(one.node) for one in present.subscribers)
    )


async def _account(robot: Robot, source: _Source, began_ns: int) -> Account:
    """Read one topic until it shows that the robot is stationary, or the time is over."""
    began_at = monotonic()
    judge: BaseJudge | JointJudge
    try:
        # A volatile subscription gets nothing that was published before it, whatever the publisher has kept. Over a
        # slow link only the newest message crosses: odometry at 50 Hz needs 0.3 Mbit/s.
        keep = "latest" if robot.graph.is_remote else "all"
        async with robot.listen(
            source.topic, source.type, keep=keep, is_volatile=True, max_bytes=_MESSAGE_BYTES
        ) as listening:
            freshness = Freshness(began_ns, is_latched=listening.choice.qos.durability != "volatile")
            if source.path is None:
                judge = JointJudge(freshness, robot.kept.get(_Reported, _Reported).joints(source.topic))
            else:
                judge = BaseJudge(freshness, source.still)
            while (state := judge.state) != "still":
                most_s = max(_FIRST_S, source.most_s) if state == "not observed" else source.most_s
                if (left_s := began_at + most_s - monotonic()) <= 0:
                    break
                for sample in await listening.take(min(left_s, _TAKE_S)):
                    judge.hear(reading_of(await robot.values.in_full(listening.type, sample.data), sample, source.path))
    except RobotError as error:
        return Account(named(source.topic), "not observed", str(error).rstrip("."))
    if isinstance(judge, JointJudge):
        robot.kept.get(_Reported, _Reported).note_joints(source.topic, judge.names)
    return Account(named(source.topic), judge.state, judge.why, is_base=source.path is not None)


# ── what messages say ──────────────────────────────────────────────────────────────────────────────────────────────


def reading_of(message: Mapping[str, Any], sample: Sample, path: str | None) -> Reading:
    """Return the motion that a message reports: the velocity at a path with its pose, or the joints if the path is
    None.
    """
    seconds, nanoseconds = _at(message, "header.stamp.sec") or 0, _at(message, "header.stamp.nanosec") or 0
    is_base = path is not None
    pose = (_at(message, "pose.pose") or _at(message, "pose")) if is_base else None
    return Reading(
        heard_s=monotonic(),
        received_ns=sample.received_ns,
        source_ns=sample.source_ns,
        header_ns=seconds * 1_000_000_000 + nanoseconds,
        joints={} if is_base else _joints_of(message),
        velocity=velocity_of(message, path) if is_base else None,
        position=_numbers(_at(pose, "position"), "xyz"),
        orientation=_numbers(_at(pose, "orientation"), "xyzw"),
    )


def velocity_of(message: Mapping[str, Any], path: str) -> Sequence[float] | None:
    """Return `linear` and `angular` below a path, x, y, z of each; None if they are missing or not finite."""
    found = _at(message, path)
    linear, angular = (_numbers(_at(found, part), "xyz") for part in ("linear", "angular"))
    if linear is None or angular is None or not all(map(math.isfinite, (*linear, *angular))):
        return None
    return (*linear, *angular)


def _joints_of(message: Mapping[str, Any]) -> Mapping[str, float]:
    names: Sequence[str] = message["name"]
    positions: Sequence[Any] = message["position"]
    told = [float(one) if isinstance(one, (int, float)) else math.nan for one in positions]
    return {str(name): told[place] if place < len(told) else math.nan for place, name in enumerate(names)}


def _at(message: Any, path: str) -> Any:
    """Return the field at a dotted path; None if there is none."""
    for part in path.split(".") if path else ():
        message = cast("Mapping[str, Any]", message).get(part) if isinstance(message, Mapping) else None
    return message


def _numbers(of: Any, fields: str) -> Sequence[float] | None:
    """Return these fields as numbers; None if a field is missing or not a number."""
    if not isinstance(of, Mapping):
        return None
    try:
        return [float(cast("Mapping[str, Any]", of)[each]) for each in fields]
    except (KeyError, TypeError, ValueError):
        return None
