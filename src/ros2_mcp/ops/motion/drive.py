"""Drive a distance, an angle or an arc: find command input, odometry and sensors, let the bridge drive, and report."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal, cast

from ros2_mcp.guard.policy import bounded
from ros2_mcp.model.commands import Move, Moved
from ros2_mcp.model.errors import BadInput, NotFound
from ros2_mcp.model.text import counted, named
from ros2_mcp.ops.acting.endings import ended_by, guarded, limited
from ros2_mcp.ops.acting.idle import why_idle, with_reason
from ros2_mcp.ops.log.complaints import complaints_from_now
from ros2_mcp.ops.motion.find import Found, base_frame_of, command_input, odometry_of
from ros2_mcp.ops.motion.guarding import WITHOUT, Guarding, guarding
from ros2_mcp.ops.motion.held import others_on, why_it_stands
from ros2_mcp.ops.motion.job import run_motion
from ros2_mcp.ops.results.results import SAID, Report, silent
from ros2_mcp.robot import Robot
from ros2_mcp.robot.session import Session
from ros2_mcp_common.wire.limits import STEER_MOST

MATCH_S = 1.0
"""Time for subscribers to match, as in `ops/topics/publish.py`."""
RATE_HZ = 20.0
"""The rate of commands: as fast as most bases follow, and well above what the time-outs of their drivers need."""
DEFAULT_MPS, DEFAULT_DEGPS = 0.2, 25.0
"""Within the limits of the policy profiles, and possible for any small robot."""
MAX_M, MAX_DEG, MAX_RADIUS_M = 100.0, 3600.0, 100.0
MIN_MPS, MAX_MPS, MIN_DEGPS, MAX_DEGPS = 0.01, 3.0, 2.0, 180.0
MIN_GUARD_M, MAX_GUARD_M = 0.1, 5.0
"""A distance below the first is no more than the noise of a scan and the distance that a robot rolls while stopping."""
_NOT_MOVED = frozenset({"silent", "stuck", "timeout", "missed", "no_subscriber"})
"""Outcomes whose reason may be a controller that is not active, or a node that is frozen."""
BLIND_M = 1.0
"""A longer drive without any sensor is reported as blind; a shorter one ends where the caller has looked."""
_SETTLES_S = 3.0
"""The time that a drive has, after its time limit, to stop and be measured (`drive.STANDS_WITHIN_S`),
before the bridge would end it."""
_SETTLES_IN_POLICY_S = 1.0
"""The same if a policy bounds the total time: most robots stop within half of it, and more time is left for driving."""
_PATIENCE = 1.5
"""The time limit is the duration of the course at that speed times this factor, and
`_ROOM_S` for ramps and corrections."""
_ROOM_S = 15.0
_PAUSES_S = 30.0
"""Pauses because a topic is late do not count towards the time limit, up to this total. Each is shorter than 0.5 s, and
a robot on a busy computer that has had sixty of them will not arrive."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveRequest:
    """The settings of a drive: `distance_m` (negative: backwards) or `angle_deg` (positive: to the left), which with
    `radius_m` is a forward arc. `speed` is in m/s, or in °/s for a turn in place. `guard_m` is kept free ahead of the
    outline: `DEFAULT_GUARD_M` if it is None and the robot has a scan or a cloud; 0 uses no sensor. Topics that are not
    given are found. `time_limit_s` is a time limit shorter than the course's.
    """

    distance_m: float | None = None
    angle_deg: float | None = None
    radius_m: float | None = None
    speed: float | None = None
    guard_m: float | None = None
    topic_name: str = ""
    odometry: str = ""
    scan: str = ""
    time_limit_s: float = math.inf

    @property
    def is_turn(self) -> bool:
        """Return whether the drive is a turn in place."""
        return self.angle_deg is not None and not self.radius_m

    @property
    def rate(self) -> float:
        """The speed in m/s, or in °/s for a turn in place."""
        return self.speed or (DEFAULT_DEGPS if self.is_turn else DEFAULT_MPS)

    @property
    def length(self) -> float:
        """The length of the course in m, or in degrees for a turn in place."""
        if self.distance_m is not None:
            return abs(self.distance_m)
        angle_deg = abs(self.angle_deg or 0.0)
        return math.radians(angle_deg) * self.radius_m if self.radius_m else angle_deg

    def check(self) -> None:
        """Raise `BadInput` or `BadValue` for an impossible drive."""
        if (self.distance_m is None) == (self.angle_deg is None):
            raise BadInput("Give either distance_m or angle_deg.", "With angle_deg, radius_m makes an arc of it.")
        if self.distance_m is not None:
            bounded("distance_m", self.distance_m, -MAX_M, MAX_M, "m")
            if self.radius_m:
                raise BadInput("radius_m needs angle_deg: an arc is given by its angle.", "Leave distance_m out.")
        bounded("angle_deg", self.angle_deg or 0.0, -MAX_DEG, MAX_DEG, "°")
        bounded("radius_m", self.radius_m or 0.0, 0.0, MAX_RADIUS_M, "m")
        if self.speed is not None and self.is_turn:
            bounded("speed", self.speed, MIN_DEGPS, MAX_DEGPS, "°/s")
        elif self.speed is not None:
            bounded("speed", self.speed, MIN_MPS, MAX_MPS, "m/s")
        if self.guard_m == 0 and self.scan:
            raise BadInput("guard_m=0 uses no sensor, but scan names one.", "Leave one of them out.")
        if self.guard_m:
            bounded("guard_m", self.guard_m, MIN_GUARD_M, MAX_GUARD_M, "m")


DriveEnd = Literal[
    "reached",
    "guard",
    "silent",
    "stuck",
    "jumped",
    "missed",
    "timeout",
    "refused",
    "no_subscriber",
    "interrupted",
]


@dataclass(frozen=True, slots=True, kw_only=True)
class Driven:
    """The result of a drive.

    `outcome` is `reached`, or what ended the drive early: `guard` (an obstacle), `silent` (no odometry or scan),
    `stuck`, `jumped` (the odometry), `missed` (still off the target after all corrections), `timeout`, `refused` (by
    the policy), `no_subscriber`, `interrupted` (by a stop, for example; `note` says by what). `measured` is the
    distance or angle by odometry, `error` what is left to `requested`, both in `unit` (`m`, `deg`). `lateral_error_m`
    is the offset to the left of the course, `heading_error_deg` the error of the heading, also by odometry. These are
    null if nothing was measured. `guard_m` is the distance that was kept free ahead of the robot's outline by the
    topics in `scan`; 0 without a sensor. `free_m` is the distance from the outline to the nearest obstacle at the end;
    sensor noise makes it smaller than the true distance.
    """

    outcome: DriveEnd = field(metadata=SAID)
    requested: float = field(metadata=SAID)
    measured: float | None = field(metadata=SAID)
    error: float | None = field(metadata=SAID)
    unit: str = field(metadata=SAID)
    lateral_error_m: float | None = None
    heading_error_deg: float | None = None
    guard_m: float = field(metadata=SAID)
    free_m: float | None = None
    elapsed_s: float = field(metadata=SAID)
    topic_name: str
    odometry: str = field(metadata=SAID)
    scan: str = ""
    note: str = ""

    @property
    def has_failed(self) -> bool:
        """Return whether the drive did not reach its end. A drive that a stop ended has not failed."""
        return self.outcome not in ("reached", "interrupted")

    def summary(self) -> str:
        """Return the result in one line."""
        unit = "°" if self.unit == "deg" else " m"
        if self.measured is None:
            return f"{self.outcome}: the robot was not moved. {self.note}".rstrip()
        error = "" if self.error is None else f", {abs(self.error):.3g}{unit} {self._side(self.error)},"
        went = f"{self.measured:.3f}{unit} of {self.requested:g}{unit}{error} by {named(self.odometry)}"
        return f"{self.outcome}: {went} in {self.elapsed_s:.1f} s. {self.note}".rstrip()

    def _side(self, error: float) -> str:
        return "short" if error * self.requested >= 0 else "too far"


async def drive(robot: Robot, session: Session, request: DriveRequest, report: Report = silent) -> Driven:
    """Drive, and return when the robot is stationary.

    Raises:
        BadInput: for an impossible drive, or if several topics may be the command input or the odometry.
        NotFound: if there is no command input or no odometry, or none of the sensors can guard the drive.
        Refused: if the policy forbids it, or another motion drives by the same command input.
        Stopped: if a stop came before anything was sent.
    """
    request.check()
    to = await command_input(robot, request.topic_name)
    odometry = await odometry_of(robot, request.odometry, to.topic)
    base, guard = "", None
    if request.guard_m != 0 or to.type.endswith("Stamped"):
        try:
            base = await base_frame_of(robot, odometry)
        except NotFound as error:  # no odometry: mostly its controller is not active either
            raise await with_reason(robot, error, to.topic, odometry.topic) from error
    if request.guard_m != 0:
        guard = await guarding(robot, base, request.guard_m, request.scan, to.topic)
    controller: dict[str, Any] = {
        "kind": "drive",
        "speed": math.radians(request.rate) if request.is_turn else request.rate,
        "odometry": odometry.feed,
        "distance_m": request.distance_m,
        "angle": None if request.angle_deg is None else math.radians(request.angle_deg),
        "radius_m": request.radius_m,
        **(guard.asked if guard else {}),
    }
    hears = [odometry.type, *(guard.hears if guard else ())]
    move = Move(
        principal=session.principal,
        name=to.topic,
        type=to.type,
        value=_fastest(request, to.type, base),
        choice=to.choice,
        controller=controller,
        hears=hears,
        wait_match_s=MATCH_S,
    )
    move = _within_policy(robot, request, move)
    complaints = complaints_from_now(robot)
    moved, reason = await run_motion(robot, session, move, report, lambda told: _line(told, request))
    notes = [_looked(request, guard, moved), await others_on(robot, move.name)]
    if moved.outcome in _NOT_MOVED:
        notes.append(await why_idle(robot, move.name, odometry.topic, is_in_doubt=True))
    if moved.outcome == "stuck":
        notes += await why_it_stands(robot, move.name, odometry, guard.topics[0] if guard else request.scan)
        notes.append(await complaints.said())
    return _driven(request, moved, reason, odometry, guard, notes)


def _looked(request: DriveRequest, guard: Guarding | None, moved: Moved) -> str:
    """Return a sentence on the sensors that guarded the drive, or on their absence."""
    if guard:
        return f"{guard.note} {WITHOUT}" if moved.outcome == "guard" else guard.note
    if request.guard_m == 0:
        return "Obstacles were not checked: guard_m was 0."
    if not request.is_turn and request.length > BLIND_M:
        return "It drove blind: the robot has no laser scan and no point cloud."
    return "Obstacles were not checked: the robot has no laser scan and no point cloud."


def _fastest(request: DriveRequest, type_name: str, base: str) -> Mapping[str, Any]:
    """Return the fastest command that the drive may send."""
    if request.is_turn:
        linear, angular = 0.0, math.radians(request.rate)
    else:
        linear = request.rate * (-1 if (request.distance_m or 0.0) < 0 else 1)
        angular = STEER_MOST + (request.rate / request.radius_m if request.radius_m else 0.0)
    if (request.angle_deg or 0.0) < 0:
        angular = -angular
    twist = {"linear": {"x": linear}, "angular": {"z": angular}}
    return {"header": {"frame_id": base}, "twist": twist} if type_name.endswith("Stamped") else twist


def _within_policy(robot: Robot, request: DriveRequest, move: Move) -> Move:
    """Return the command with a rate and a time limit that fit the course and the policy."""
    limit_s = min(_PATIENCE * request.length / request.rate + _ROOM_S, request.time_limit_s)
    pauses_s, settles_s = _PAUSES_S, _SETTLES_S
    rate_hz = move.rate_hz
    if ruling := robot.policy.ruling(move):
        rate_hz = min(rate_hz, ruling.most("rate_hz") or rate_hz)
        for_s = ruling.most("for_s") or math.inf
        if limit_s + pauses_s + settles_s > for_s:  # pauses count towards this limit, too
            settles_s = _SETTLES_IN_POLICY_S
            limit_s = min(limit_s, max(settles_s, for_s - settles_s))
            pauses_s = max(0.0, min(pauses_s, for_s - settles_s - limit_s))
    controller = {**move.controller, "time_limit_s": limit_s, "pauses_s": pauses_s}
    return replace(move, rate_hz=rate_hz, duration_s=limit_s + pauses_s + settles_s, controller=controller)


def _line(told: Mapping[str, Any], request: DriveRequest) -> tuple[float, float, str]:
    unit = "°" if request.is_turn else " m"
    done, whole = abs(float(told.get("done", 0.0))), abs(float(told.get("whole", 0.0)))
    paused = f", stood still for {told['paused_s']:.1f} s" if told.get("paused_s") else ""
    return done, whole, f"driven {done:.2f}{unit} of {whole:g}{unit}{paused}"


def _driven(
    request: DriveRequest, moved: Moved, reason: str, odometry: Found, guard: Guarding | None, notes: list[str]
) -> Driven:
    told, sent = moved.report, moved.sent
    has_moved = bool(told) and sent.sent > 0
    sign = -1.0 if (request.distance_m if request.distance_m is not None else request.angle_deg or 0.0) < 0 else 1.0
    corrections = int(told.get("corrections", 0))
    notes = [
        ended_by(reason) if reason else "",
        moved.why,
        f"It made {counted(corrections, 'correction')}." if corrections else "",
        f"It paused for {told['paused_s']:g} s because a topic was late." if told.get("paused_s") else "",
        limited(sent.limited) if sent.limited else "",
        guarded(sent.stopper_s, sent.unguarded),
        *notes,
    ]
    is_arc = bool(request.radius_m)

    def measured(name: str) -> float | None:
        return cast("float", told[name]) if has_moved and told.get(name) is not None else None

    return Driven(
        outcome=cast("DriveEnd", moved.outcome or "interrupted"),
        requested=round(request.length if is_arc else sign * request.length, 4),
        measured=measured("done"),
        error=measured("error"),
        unit="deg" if request.is_turn else "m",
        lateral_error_m=measured("aside_m"),
        heading_error_deg=None if request.is_turn else measured("heading_deg"),
        guard_m=guard.guard_m if guard else 0.0,
        free_m=measured("nearest_m"),
        elapsed_s=round(sent.elapsed_s, 2) if sent.sent else 0.0,
        topic_name=sent.topic,
        odometry=odometry.topic,
        scan=", ".join(guard.topics) if guard else "",
        note=" ".join(filter(None, notes)),
    )
