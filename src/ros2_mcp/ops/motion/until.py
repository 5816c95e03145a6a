"""`ros2_move_until`: move at a velocity until a condition on a topic holds, which the bridge evaluates."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal, cast

from ros2_mcp.guard.policy import bounded
from ros2_mcp.model.aside import load
from ros2_mcp.model.commands import Move, Moved
from ros2_mcp.model.errors import BadInput, RobotError
from ros2_mcp.model.poses import Pose
from ros2_mcp.model.text import named, quoted
from ros2_mcp.ops.acting.endings import ended_by, guarded, limited
from ros2_mcp.ops.acting.idle import why_idle
from ros2_mcp.ops.motion.find import Found, base_frame_of, command_input, first_decoded, located_on, odometry_of
from ros2_mcp.ops.motion.held import others_on, why_it_stands
from ros2_mcp.ops.motion.job import run_motion
from ros2_mcp.ops.results.results import SAID, Report, silent, told_values
from ros2_mcp.ops.sources.from_before import FromBefore, outcome_in_words
from ros2_mcp.robot import Robot
from ros2_mcp.robot.session import Session
from ros2_mcp_common.language.scans import LASER_SCAN
from ros2_mcp_common.wire.limits import MAX_DURATION_S

_RATE_HZ = 20.0
"""The rate of commands that velocity controllers expect. The zero at the end is sent at once."""
_TURNED_DEG = 5.0
"""A smaller rotation is inaccurate mounting; a larger rotation is intended."""
_STOOD_M = 0.01
"""A motion over a shorter distance did not move the robot: odometry is that noisy."""
_ANGLES = re.compile(r"\b(nearest|range_at)\s*\(")
_MATCH_S = 1.0
"""Time for subscribers to match: a running node matches within milliseconds."""


@dataclass(frozen=True, slots=True, kw_only=True)
class UntilRequest:
    """The settings of a motion: `velocity` has numbers by name, such as `linear.x` (m/s) and `angular.z` (rad/s).

    `is_event`: the topic reports only events, and so may send no message for long. Empty topics are found.
    """

    topic_name: str
    condition: str
    velocity: Mapping[str, float]
    timeout_s: float
    max_distance_m: float | None = None
    is_event: bool = False
    command_topic: str = ""
    odometry_topic: str = ""


UntilEnd = Literal["met", "distance", "timeout", "silent", "no_subscriber", "refused", "interrupted"]


@dataclass(frozen=True, slots=True, kw_only=True)
class MovedUntil:
    """The result of a motion. `outcome` says what ended it: `met`, `distance` (max_distance_m), `timeout`, `silent` (a
    topic or odometry stopped publishing), `no_subscriber`, `refused` (by the policy), or `interrupted` (`note` says by
    what).

    `values` has the fields of the condition from the last message checked; `from_before` is set if that message had
    been published before this call, and gives its age. For `not_evaluable` of the `messages_checked` the condition had
    no value. `distance_m` is the distance by odometry until the last command; null without odometry.
    """

    outcome: UntilEnd
    met: bool = field(metadata=SAID)
    topic_name: str = field(metadata=SAID)
    topic_type: str
    condition: str = field(metadata=SAID)
    values: Mapping[str, Any] = field(metadata=SAID)
    messages_checked: int
    not_evaluable: int
    command_topic: str
    velocity: Mapping[str, float]
    sent: int
    elapsed: float = field(metadata=SAID)
    distance_m: float | None = field(metadata=SAID)
    odometry_topic: str = field(default="", metadata=SAID)
    stopped_with_zero: bool = False
    note: str = ""
    from_before: str = field(default="", metadata=SAID)

    @property
    def has_failed(self) -> bool:
        """Return whether something went wrong. A limit of time or distance that the caller
        gave, and a stop, are no failures.
        """
        return self.outcome in ("silent", "no_subscriber", "refused")

    def summary(self) -> str:
        """Return the result in one line."""
        way = (
            ""
            if self.distance_m is None
            else f" According to {named(self.odometry_topic)} the robot moved {self.distance_m:.2f} m."
        )
        outcome = outcome_in_words(
            met=self.met,
            values=told_values(self.values),
            waited=f"after {self.elapsed:.2f} s",
            from_before=self.from_before,
        )
        return f"{named(self.topic_name)}: {self.condition} {outcome}.{way} {self.note}".rstrip()


async def move_until(robot: Robot, session: Session, request: UntilRequest, report: Report = silent) -> MovedUntil:
    """Move until a message meets the condition, a limit is reached, or a required topic stops sending messages.

    Raises:
        BadInput: without a velocity, or if the text is not a condition.
        BadValue: for a field that does not exist, or a limit that is out of range.
        NotFound: for a topic that does not exist.
        Refused: if the policy forbids it, or another motion drives by the same command input.
        Stopped: if a stop came before anything was sent.
    """
    bounded("timeout_s", request.timeout_s, 0.0, MAX_DURATION_S, "s")
    velocity = {name: speed for name, speed in request.velocity.items() if speed}
    if not velocity or not all(map(math.isfinite, velocity.values())):
        raise BadInput(
            "No velocity is given.", "Give a velocity such as linear_x (m/s); ros2_wait_until waits without moving."
        )
    present = await robot.graph.endpoints(request.topic_name)
    topic_type = await robot.types.topic(present, "")
    await robot.values.learn(topic_type)
    await load("ros2_mcp.ops.measure.expression")
    from ros2_mcp.ops.measure.expression import condition

    text = condition(robot.values.definitions, topic_type, request.condition).text
    to = await command_input(robot, request.command_topic)
    odometry = await _odometry(robot, request, to.topic)
    command = Move(
        principal=session.principal,
        name=to.topic,
        type=to.type,
        value=_command(velocity, to.type),
        choice=to.choice,
        controller={
            "kind": "until",
            "topic": present.topic,
            "type": topic_type,
            "condition": text,
            "velocity": velocity,
            "may_be_silent": request.is_event,
            "odometry": {"topic": odometry.topic, "type": odometry.type} if odometry else None,
            "max_distance_m": request.max_distance_m,
        },
        hears=[topic_type, *([odometry.type] if odometry else [])],
        rate_hz=_RATE_HZ,
        duration_s=request.timeout_s,
        wait_match_s=_MATCH_S,
    )

    def line(told: Mapping[str, Any]) -> tuple[float, float, str]:
        way = "" if told["distance_m"] is None else f", {told['distance_m']:.2f} m"
        return told["elapsed_s"], request.timeout_s, f"{present.topic}: not met{way}, {told_values(told['values'])}"

    turned = await _turned(robot, present.topic, topic_type, text, odometry)
    if ruling := robot.policy.ruling(command):
        command = replace(command, rate_hz=min(_RATE_HZ, ruling.most("rate_hz") or _RATE_HZ))
    moved, reason = await run_motion(robot, session, command, report, line)
    held = [await others_on(robot, to.topic)]
    if moved.sent.sent and moved.outcome != "met" and (moved.report["distance_m"] or 0.0) < _STOOD_M:
        held += await why_it_stands(robot, to.topic, odometry) if odometry else ()
        held.append(await why_idle(robot, to.topic, odometry.topic if odometry else "", is_in_doubt=bool(odometry)))
    return _result(command, moved, reason, " ".join(filter(None, [turned, *held])))


async def _turned(robot: Robot, topic: str, topic_type: str, text: str, odometry: Found | None) -> str:
    """Return a sentence on the rotation of the scan's frame on the robot, if the condition uses angles and
    there is a rotation; else nothing.
    """
    if topic_type != LASER_SCAN or not odometry or not _ANGLES.search(text):
        return ""
    try:
        frame = str((await first_decoded(robot, Found(topic, topic_type))).header.frame_id)
        base = await base_frame_of(robot, odometry)
        located = await located_on(robot, frame, base)
    except RobotError:  # a robot need not publish its transforms
        return ""
    return turned_by(located.pose, frame, base) if located else ""


def turned_by(mount: Pose, frame: str, base: str) -> str:
    """Return the sentence on a scan's frame that is rotated relative to the base; empty if it is not."""
    turned_deg = math.degrees(mount.yaw_rad)
    if abs(turned_deg) < _TURNED_DEG:
        return ""
    return f"Angles count from the x axis of {named(frame)}, which is turned by {turned_deg:.0f}° in {named(base)}."


async def _odometry(robot: Robot, request: UntilRequest, beside: str) -> Found | None:
    """Return the odometry by which the distance is measured; None if none is found and none is required."""
    try:
        return await odometry_of(robot, request.odometry_topic, beside)
    except RobotError:
        if request.odometry_topic or request.max_distance_m is not None:
            raise
        return None


def _command(velocity: Mapping[str, float], type_name: str) -> Mapping[str, Any]:
    """Return the velocity as a message; a stamped message has the frame base_link."""
    twist: dict[str, dict[str, float]] = {"linear": {}, "angular": {}}
    for name, speed in velocity.items():
        part, _, axis = name.partition(".")
        twist[part][axis] = speed
    return {"header": {"frame_id": "base_link"}, "twist": twist} if type_name.endswith("Stamped") else twist


def _result(command: Move, moved: Moved, reason: str, known: str) -> MovedUntil:
    told, sent, asked = moved.report, moved.sent, command.controller
    notes = [ended_by(reason) if reason else moved.why]
    if told["met"] and not sent.sent:
        notes.append("The condition was met already: nothing was sent.")
    if told["undecided"]:
        undecided = f"The condition could not be evaluated for {told['undecided']} of {told['looked_at']} messages"
        notes.append(f"{undecided}{f': {quoted(why)}' if (why := told['why_undecided']) else ''}.")
    if told["paused_s"]:
        notes.append(f"It paused for {told['paused_s']:.1f} s while a topic was late.")
    if sent.limited:
        notes.append(limited(sent.limited))
    notes.append(known)
    notes.append(guarded(sent.stopper_s, sent.unguarded))
    if sent.stopped_with_zero:
        notes.append("A zero command was sent at the end.")
    odometry = asked["odometry"]
    return MovedUntil(
        outcome="interrupted" if reason else cast("UntilEnd", moved.outcome),
        met=told["met"],
        topic_name=asked["topic"],
        topic_type=asked["type"],
        condition=asked["condition"],
        values=told["values"],
        messages_checked=told["looked_at"],
        not_evaluable=told["undecided"],
        command_topic=command.name,
        velocity=asked["velocity"],
        sent=sent.sent,
        elapsed=told["elapsed_s"],
        distance_m=told["distance_m"],
        odometry_topic=odometry["topic"] if odometry else "",
        stopped_with_zero=sent.stopped_with_zero,
        note=" ".join(filter(None, notes)),
        from_before=str(FromBefore.one(told["from_before_s"])),
    )
