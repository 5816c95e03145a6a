"""Finds the topics that report the robot's motion, and listens until they show whether it stands after a stop."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from time import monotonic
from typing import Any, cast

from ros2_mcp.guard.document import ODOMETRY, Feedback
from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.graph import TopicRow
from ros2_mcp.model.samples import Sample
from ros2_mcp.model.text import listed, named
from ros2_mcp.ops.motion.controllers import FOLLOW
from ros2_mcp.ops.motion.joint_states import JOINT_STATE
from ros2_mcp.ops.observed.judge import (
    HOVERING,
    JOINT_WINDOW_S,
    NOTHING_CAME,
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
from ros2_mcp.robot.seen import is_of_robot

_KINDS: Mapping[str, int] = {ODOMETRY: 3, JOINT_STATE: 8}
"""What reports motion, and how many topics of each are read: wheels, fused, visual; arm, gripper, wheels. All that are
read have to say that it stands."""
_MOST_INPUTS = 5
"""Velocity topics that are looked up where no odometry is: a base, its multiplexer, a servo."""
_FOUND_S = 0.3
"""For a look at the graph: the bridge has it at once, unless discovery is still under way."""
_FIRST_S = 2.5
"""For a first message: publishers are matched in 0.02 to 0.2 s on one host, and tell of motion at 1 Hz or more."""
_RESTS_S = 1.5
"""For joints to come to rest: a hold is there within tenths of a second, and an arm then brakes."""
_BRAKED_S = 3.0
"""From 5 m/s, with the 2.5 m/s² at which ArduCopter brakes by default, and a second for the mode to be taken."""
_BEGINS_S = 0.5
"""For subscribing, beyond the time that the robot has to come to rest."""
_TAKE_S = 0.1
"""Between two looks at the time while nothing comes."""
_MESSAGE_BYTES = 1_000_000
"""Of what waits: a second of odometry of 1 kHz with its covariances."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Source:
    """A topic that reports motion: of joints where it has no `path`. `most_s` is for coming to rest."""

    topic: str
    type: str
    most_s: float
    path: str | None = None
    still: Still = field(default_factory=Still)


async def observe_still(robot: Robot, *, hovers: bool = False) -> Observation:
    """What all topics that report motion say from now on, until they show that the robot stands, at most for the time
    that it has to come to rest, and for 2.5 s where one tells nothing. Never raises a `RobotError`.

    A vehicle that `hovers` is given time to brake, and may sway where it is.
    """
    began_ns = robot.now_ns()
    try:
        sources, missing, unreported = await _sources(robot, hovers)
    except RobotError as error:
        return Observation(verdict="not observed", sentence=f"Not observed: {error}", is_open=True)
    accounts = await asyncio.gather(*(_account(robot, source, began_ns) for source in sources))
    return observation(accounts, missing=missing, unreported=unreported, hovers=hovers)


async def _sources(robot: Robot, hovers: bool) -> tuple[Sequence[_Source], Sequence[str], Sequence[str]]:
    """The topics to be read; in words, what should report motion and does not, and what nothing reports of."""
    rows = list(await robot.graph.topics(_FOUND_S))
    odometry, joint_states = await asyncio.gather(*(_published(robot, _first_of(rows, kind), kind) for kind in _KINDS))
    beyond = {row.name for row in rows if row.publishers} - {*_first_of(rows, ODOMETRY), *_first_of(rows, JOINT_STATE)}
    missing = [
        f"{named(topic)} reported motion before, and nobody publishes it any more"
        for topic in robot.graph.seen.published(_KINDS)
        if topic not in {*odometry, *joint_states, *beyond}
    ]
    if not joint_states and _has_moved_joints(robot):
        missing.append("no joint state says whether the joints stand that this server has moved")
    named_ones = [found.feedback for found in robot.policy.documents if found.feedback]
    sources = [_base_source(feedback, hovers=False) for feedback in named_ones]
    sources = sources or [_base_source(Feedback(topic=topic), hovers) for topic in odometry]
    unreported: list[str] = []
    if joint_states and not sources:
        inputs = [row.name for row in rows if VELOCITY_TYPES.keys() & {*row.types} and row.subscribers]
        if driven := await _subscribed(robot, inputs[:_MOST_INPUTS]):
            unreported = [f"no odometry says whether what {listed(driven, 3)} drives stands"]
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


def _first_of(rows: Sequence[TopicRow], kind: str) -> Sequence[str]:
    """The topics of that type that somebody publishes, as many as are read, in order of their names."""
    return sorted(row.name for row in rows if kind in row.types and row.publishers)[: _KINDS[kind]]


async def _published(robot: Robot, topics: Sequence[str], kind: str) -> Sequence[str]:
    """Those that a node of the robot publishes, not only this server or another one; in order."""
    found = await asyncio.gather(*(robot.graph.endpoints(topic, _FOUND_S) for topic in topics))
    return sorted(
        present.topic
        for present in found
        if any(one.type == kind and not one.ours and is_of_robot(one.node) for one in present.publishers)
    )


async def _subscribed(robot: Robot, topics: Sequence[str]) -> Sequence[str]:
    """Those that a node of the robot subscribes to."""
    found = await asyncio.gather(*(robot.graph.endpoints(topic, _FOUND_S) for topic in topics))
    return sorted(
        present.topic for present in found if any(not one.ours and is_of_robot(one.node) for one in present.subscribers)
    )


async def _account(robot: Robot, source: _Source, began_ns: int) -> Account:
    """Listens to one topic until it shows that the robot stands, or the time is over."""
    began_at = monotonic()
    judge: BaseJudge | JointJudge | None = None
    try:
        # A volatile subscription is given nothing that was published before it, whatever the publisher has kept.
        async with robot.listen(source.topic, source.type, is_volatile=True, max_bytes=_MESSAGE_BYTES) as listening:
            freshness = Freshness(began_ns, is_latched=listening.choice.qos.durability != "volatile")
            if source.path is None:
                judge = JointJudge(freshness, robot.reported.joints(source.topic))
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
        robot.reported.note_joints(source.topic, judge.names)
    return (
        Account(named(source.topic), judge.state, judge.why)
        if judge
        else Account(named(source.topic), "not observed", NOTHING_CAME)
    )


# ── what messages say ──────────────────────────────────────────────────────────────────────────────────────────────


def reading_of(message: Mapping[str, Any], sample: Sample, path: str | None) -> Reading:
    """What a message says of motion: the velocity at a path and the pose beside it, or without one the joints."""
    seconds, nanoseconds = _at(message, "header.stamp.sec") or 0, _at(message, "header.stamp.nanosec") or 0
    is_base = path is not None
    pose = (_at(message, "pose.pose") or _at(message, "pose")) if is_base else None
    return Reading(
        received_ns=sample.received_ns,
        source_ns=sample.source_ns,
        header_ns=seconds * 1_000_000_000 + nanoseconds,
        joints={} if is_base else _joints_of(message),
        velocity=velocity_of(message, path) if is_base else None,
        position=_numbers(_at(pose, "position"), "xyz"),
        orientation=_numbers(_at(pose, "orientation"), "xyzw"),
    )


def velocity_of(message: Mapping[str, Any], path: str) -> Sequence[float] | None:
    """`linear` and `angular` below a path, x, y, z of each; None where they are not there, or not finite."""
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
    """The field at a path; None where there is none."""
    for part in path.split(".") if path else ():
        message = cast("Mapping[str, Any]", message).get(part) if isinstance(message, Mapping) else None
    return message


def _numbers(of: Any, fields: str) -> Sequence[float] | None:
    """These fields as numbers; None where one is not there or no number."""
    if not isinstance(of, Mapping):
        return None
    try:
        return [float(cast("Mapping[str, Any]", of)[each]) for each in fields]
    except (KeyError, TypeError, ValueError):
        return None
