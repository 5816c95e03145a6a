"""Whether the robot is seen to stand after a stop: a zero that was sent, and has arrived, is no robot that stands."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from time import monotonic
from typing import Any, Literal, cast

import anyio

from ros2_mcp.guard.document import ODOMETRY, Feedback
from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.text import named
from ros2_mcp.ops.motion.controllers import FOLLOW
from ros2_mcp.ops.motion.joint_states import At, joint_states
from ros2_mcp.robot import HOLD_TYPES, Robot
from ros2_mcp.robot.goals import Goal

_MOST_TOPICS = 3
"""Of odometry that no policy names: wheels, fused, visual. All that are read have to say that it stands."""
_FOUND_S = 0.3
"""For the list of topics: the bridge has it at once, unless discovery is still under way."""
_BEGINS_S = 0.5
"""For a first message after subscribing, beyond the time that the robot has to come to rest."""
_HOVERING = {"linear": 0.3, "angular": 0.2}
"""m/s and rad/s, of a vehicle that keeps its place in gusts: several times the drift of the simulated one."""
_BRAKED_S = 3.0
"""From 5 m/s, with the 2.5 m/s² at which ArduCopter brakes by default, and a second for the mode to be taken."""
_MESSAGE_BYTES = 1_000_000
"""Of odometry that waits: a second of 1 kHz with its covariances."""

_JOINTS_S, _LOOK_S, _STANDS = 2.0, 0.1, 0.002
"""For joints: a hold is there within tenths of a second, and an arm then brakes. One that moves by less than the
last, in rad or m, between two looks stands: encoders' noise is far below."""
_NO_ODOMETRY = "Not observed: no odometry reports whether the robot has stopped."

Observed = Literal["observed still", "not observed"]


@dataclass(frozen=True, slots=True)
class Observation:
    """`verdict`, and a sentence with what it is known by; `is_moving` if the robot was seen to move at the end."""

    verdict: Observed
    sentence: str
    is_moving: bool = False


async def observe_still(robot: Robot, *, hovers: bool = False) -> Observation:
    """What odometry says, and where this server has moved joints, what joint states say: all that say something have to
    say that it stands. Never raises a `RobotError`. A vehicle that `hovers` is given time to brake, and may drift.
    """
    if not _has_moved_joints(robot):
        return await _observe_base(robot, hovers)
    base, joints = await asyncio.gather(_observe_base(robot, hovers), _observe_joints(robot))
    if base.sentence == _NO_ODOMETRY:
        return joints
    both = base.verdict == joints.verdict == "observed still"
    sentence = f"{base.sentence} {joints.sentence}"
    return Observation("observed still" if both else "not observed", sentence, base.is_moving or joints.is_moving)


def _has_moved_joints(robot: Robot) -> bool:
    return any(driven.type in HOLD_TYPES for driven in robot.failsafes.driven) or any(
        goal.action_type == FOLLOW for goal in robot.jobs.all(Goal)
    )


async def _observe_joints(robot: Robot) -> Observation:
    """Reads the joint states until no joint moves, at most for `_JOINTS_S`."""
    began_at, fastest = monotonic(), ""
    try:
        async with joint_states(robot) as states:
            before: dict[str, At] = {}
            while monotonic() - began_at < _JOINTS_S:
                await anyio.sleep(_LOOK_S)
                now = dict(states.positions)
                if not before or any(now[name].heard_at - then.heard_at < _LOOK_S / 2 for name, then in before.items()):
                    before = before or now  # every joint has to be heard of anew: what is silent does not stand
                    continue
                moved = {name: abs(now[name].position - then.position) for name, then in before.items()}
                fastest = max(moved, key=lambda name: moved[name])
                if moved[fastest] < _STANDS:
                    return Observation("observed still", "Observed still: the joint states report that no joint moves.")
                before = now
    except RobotError as error:
        return Observation("not observed", f"Not observed: {error}")
    if not fastest:
        return Observation("not observed", "Not observed: some joints published no state.")
    sentence = f"NOT observed still: {named(fastest)} still moves after {_JOINTS_S:g} s, by the joint states."
    return Observation("not observed", sentence, is_moving=True)


async def _observe_base(robot: Robot, hovers: bool) -> Observation:
    """Reads the odometry until it says that the robot stands, at most for the policy's `within_s` (else 1 s) and what
    subscribing takes.
    """
    began_at = monotonic()
    try:
        feedback = await _feedback(robot, hovers)
        if not feedback:
            return Observation("not observed", _NO_ODOMETRY)
        spoken: dict[str, tuple[float, float]] = {}
        async with anyio.create_task_group() as group:
            for one in feedback:
                group.start_soon(_watch, robot, one, spoken)
    except RobotError as error:
        return Observation("not observed", f"Not observed: {error}")
    return _judged(feedback, spoken, monotonic() - began_at)


async def _feedback(robot: Robot, hovers: bool) -> Sequence[Feedback]:
    """What the policies name; else all odometry that is there."""
    if named_ones := [found.feedback for found in robot.policy.documents if found.feedback]:
        return named_ones
    rows = await robot.graph.topics(_FOUND_S)
    found = [row.name for row in rows if ODOMETRY in row.types and row.publishers]
    in_the_air: Mapping[str, Any] = {"still": _HOVERING, "within_s": _BRAKED_S} if hovers else {}
    return [Feedback(topic=topic, **in_the_air) for topic in sorted(found)[:_MOST_TOPICS]]


async def _watch(robot: Robot, feedback: Feedback, spoken: dict[str, tuple[float, float]]) -> None:
    """Notes the last speeds (m/s, rad/s) of a topic, until they say that the robot stands or the time is over."""
    try:
        async with robot.listen(feedback.topic, feedback.type, max_bytes=_MESSAGE_BYTES) as listening:
            async for sample in listening.samples(feedback.within_s + _BEGINS_S):
                speeds = speeds_of(await robot.values.in_full(listening.type, sample.data), feedback.path)
                if speeds:
                    spoken[feedback.topic] = speeds
                    if _stands(feedback, speeds):
                        return
    except RobotError:
        return  # what is not heard is not observed


def speeds_of(message: Mapping[str, Any], path: str) -> tuple[float, float] | None:
    """The lengths of `linear` and `angular` below a path; None where they are not there, or not finite."""
    found: Any = message
    for part in path.split(".") if path else ():
        found = cast("Mapping[str, Any]", found).get(part) if isinstance(found, Mapping) else None
    if not isinstance(found, Mapping):
        return None
    try:
        linear, angular = (
            math.hypot(*(float(number) for number in cast("Mapping[str, Any]", found)[part].values()))
            for part in ("linear", "angular")
        )
    except (KeyError, TypeError, ValueError, AttributeError):
        return None
    return (linear, angular) if math.isfinite(linear + angular) else None


def _stands(feedback: Feedback, speeds: tuple[float, float]) -> bool:
    return all(
        speed <= feedback.still.get(part, math.inf) for part, speed in zip(("linear", "angular"), speeds, strict=True)
    )


def _judged(feedback: Sequence[Feedback], spoken: Mapping[str, tuple[float, float]], elapsed_s: float) -> Observation:
    said = "; ".join(
        f"{named(topic)} reports {linear:.2f} m/s and {angular:.2f} rad/s"
        for topic, (linear, angular) in spoken.items()
    )
    silent = [named(one.topic) for one in feedback if one.topic not in spoken]
    moving = [one for one in feedback if one.topic in spoken and not _stands(one, spoken[one.topic])]
    if moving:
        return Observation("not observed", f"NOT observed still: {said}, after {elapsed_s:.1f} s.", is_moving=True)
    if silent:
        return Observation("not observed", f"Not observed: {', '.join(silent)} did not report the robot's speed.")
    return Observation("observed still", f"Observed still: {said}.")
