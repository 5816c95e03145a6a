"""`ros2_nav_probe`: move a little, and compare what odometry, laser and gyro see of it with the command."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Literal

import anyio

from ros2_mcp.model.aside import aside, load
from ros2_mcp.model.errors import NotFound, RobotError
from ros2_mcp.model.poses import Pose, rotated
from ros2_mcp.model.samples import Sample
from ros2_mcp.model.text import named
from ros2_mcp.ops.motion.body import body_of
from ros2_mcp.ops.motion.drive import Driven, DriveRequest, drive
from ros2_mcp.ops.motion.find import Found, base_frame_of, command_input, odometry_of
from ros2_mcp.ops.motion.guarding import candidates
from ros2_mcp.ops.navigation.checks.probed import CHECK, in_words
from ros2_mcp.ops.navigation.evidence import ODOMETRY, SCAN, Motion, NavEvidence, NavFinding, Probe, speed_of
from ros2_mcp.ops.results.results import IF_ANY, SAID, Report, silent
from ros2_mcp.ops.sources.live import Live
from ros2_mcp.ops.sources.source import GraphSnapshot
from ros2_mcp.ops.space.frames import pose_in
from ros2_mcp.robot import Robot
from ros2_mcp.robot.session import Session
from ros2_mcp_common.geometry import yaw_rad

What = Literal["both", "drive", "turn"]
DISTANCE_M, SPEED_MPS = 0.2, 0.1
ANGLE_DEG, SPEED_DEGPS = 30.0, 25.0
_DRIVE_S, _TURN_S = 3.0, 2.5
"""Time limits: with odometry that is wrong a drive by it has no other end. At these speeds the robot drives 0.3 m and
turns by 63° at most."""
_ROOM_M = 0.5
"""What must be free around the outline, in all directions: the lidar may be turned, and then the guard looks elsewhere.
Twice the distance, and some."""
_LEAST_TURN_RAD = math.radians(75)
_MOST_SEEN_M, _MOST_SEEN_TURNED_RAD = 0.6, math.radians(15)
"""The motions that are looked for in the scans: of a turn, and of a drive."""
_IMU = "sensor_msgs/msg/Imu"
_MOST_OF_KIND = 3
_FIRST_S = 3.0
"""Time for a first message of each topic."""
_STOOD_S = 1.0
"""For the gyro's bias, while the robot stands."""
_ARRIVES_S = 0.4
"""Time for the last messages after the robot was seen to stand; the slowest scanners scan five times a second."""
_MOVES_MPS, _TURNS_RADPS = 0.02, 0.05
_LONGEST_STEP_S = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class NavProbed:
    """Whether the robot moves as it is commanded, by its odometry, laser and gyro: `AS COMMANDED`, `WRONG` (see
    `findings`), or `NOT KNOWN`.

    For each motion, `measured` says what was commanded and what each sensor measured.
    """

    verdict: Literal["AS COMMANDED", "WRONG", "NOT KNOWN"] = field(metadata=SAID)
    findings: Sequence[NavFinding] = field(metadata={**IF_ANY, **SAID})
    measured: Sequence[str] = field(metadata=SAID)
    note: str = ""

    @property
    def has_failed(self) -> bool:
        """Whether nothing was found out."""
        return self.verdict == "NOT KNOWN"

    def summary(self) -> list[str]:
        """Return the verdict, one line per finding, and what was measured."""
        lines = [f"{self.verdict}. {self.note}".rstrip()]
        lines += [f"{one.rank}: {one.cause} Remedy: {one.remedy}" for one in self.findings]
        return [*lines, *self.measured]


async def probe(robot: Robot, session: Session, what: What = "both", report: Report = silent) -> NavProbed:
    """Drive 0.2 m ahead and turn by 30° to the left, and judge what was measured meanwhile.

    Raises:
        NotFound: without a laser scan, odometry or command input.
        RobotError: what `ros2_drive` raises, such as a refusal by the policy; nothing has moved then.
    """
    await load("ros2_mcp.values.cdr", "ros2_mcp.world.scans", "ros2_mcp.world.scan_motion")  # with numpy
    to = await command_input(robot)
    odometry = await odometry_of(robot, "", to.topic)
    scans = [one for one in await candidates(robot, to.topic) if one.type == SCAN][:_MOST_OF_KIND]
    if not scans:
        raise NotFound("No laser scan was found: nothing would see what is in the way.", "ros2_topic_list shows them.")
    base = await base_frame_of(robot, odometry)
    rows = [row for row in await robot.graph.topics() if row.publishers]
    others = [Found(row.name, ODOMETRY) for row in rows if ODOMETRY in row.types and row.name != odometry.topic]
    imus = [Found(row.name, _IMU) for row in rows if _IMU in row.types][:_MOST_OF_KIND]
    watched = [odometry, *others[: _MOST_OF_KIND - 1], *scans, *imus, Found(to.topic, to.type)]
    radius_m = (await body_of(robot, base, to.topic)).sides["radius"]
    record = _Record(robot, watched, base)
    outcome: NavProbed | RobotError = RobotError("The small move was not made.")
    async with anyio.create_task_group() as group:
        for one in watched:
            group.start_soon(record.hear, one.topic)
        try:
            outcome = await _moved(robot, session, record, what, report, odometry=odometry.topic, radius_m=radius_m)
        except RobotError as error:  # the group would wrap it
            outcome = error
        group.cancel_scope.cancel()
    if isinstance(outcome, RobotError):
        raise outcome
    return outcome


async def _moved(
    robot: Robot, session: Session, record: _Record, what: What, report: Report, *, odometry: str, radius_m: float
) -> NavProbed:
    """Make the motions, and judge what was recorded."""
    await record.begun([odometry])
    if why := await record.why_not(odometry, radius_m):
        return NavProbed(verdict="NOT KNOWN", findings=(), measured=(), note=f"Nothing was moved: {why}")
    await asyncio.sleep(_STOOD_S)
    probes: list[Probe] = []
    note = ""
    for is_turn in (False, True):
        if what == ("drive" if is_turn else "turn"):
            continue
        since_ns = robot.now_ns()
        try:
            driven = await drive(robot, session, _request(is_turn), report)
        except RobotError as error:
            if not probes:
                raise
            note = f'The turn was not made: {error} Then: ros2_nav_probe(what="turn").'
            break
        await asyncio.sleep(_ARRIVES_S)
        probes.append(await record.probe(is_turn, since_ns))
        if note := _ended(driven):
            break
    return _judged(probes, note)


def _request(is_turn: bool) -> DriveRequest:
    if is_turn:
        return DriveRequest(angle_deg=ANGLE_DEG, speed=SPEED_DEGPS, time_limit_s=_TURN_S)
    return DriveRequest(distance_m=DISTANCE_M, speed=SPEED_MPS, time_limit_s=_DRIVE_S)


def _ended(driven: Driven) -> str:
    """Say how a motion ended that neither came to its end nor used up its time; wrong odometry explains such an end."""
    return "" if driven.outcome in ("reached", "timeout", "missed") else driven.summary()


def _judged(probes: Sequence[Probe], note: str) -> NavProbed:
    findings = list(CHECK.find(NavEvidence(graph=GraphSnapshot({}, ()), probes=probes)))
    measured = [in_words(one) for one in probes]
    known = [one for one in probes if one.laser or (one.is_turn and one.gyro)]
    has_moved = any(
        abs(one.turned_rad if probe.is_turn else math.hypot(one.ahead_m, one.left_m)) > 0.3 * abs(probe.commanded)
        for probe in known
        for one in (*probe.odometry.values(), *probe.laser.values())
    )
    if findings:
        return NavProbed(verdict="WRONG", findings=findings, measured=measured, note=note)
    if known and not has_moved:
        why = "The robot did not move: see why with ros2_nav_check (motors, emergency stop, another node's commands)."
        return NavProbed(verdict="NOT KNOWN", findings=(), measured=measured, note=f"{why} {note}".rstrip())
    if len(known) < len(probes) or not probes:
        why = "The scans before and after do not fit each other well enough to say how the robot moved."
        return NavProbed(verdict="NOT KNOWN", findings=(), measured=measured, note=f"{why} {note}".rstrip())
    return NavProbed(verdict="AS COMMANDED", findings=(), measured=measured, note=note)


# ── the witnesses ──────────────────────────────────────────────────────────────────────────────────────────────────


class _Record:
    """The messages of some topics, as they arrive; the last topic is that of the commands."""

    def __init__(self, robot: Robot, topics: Sequence[Found], base: str) -> None:
        self._command = topics[-1].topic
        self._robot, self._base = robot, base
        self._types = {one.topic: one.type for one in topics}
        self._samples: dict[str, list[Sample]] = {one.topic: [] for one in topics}

    async def hear(self, topic: str) -> None:
        """Record a topic until cancelled."""
        while True:
            try:
                async with self._robot.listen(topic, self._types[topic], is_volatile=True) as listening:
                    while True:
                        self._samples[topic] += await listening.take(1.0)
            except RobotError:
                await asyncio.sleep(_ARRIVES_S)

    async def begun(self, topics: Sequence[str]) -> None:
        """Wait until each of these topics, and each scan, has sent a message. Raises `NotFound` if one does not."""
        topics = [*topics, *self._of(SCAN)]
        with anyio.move_on_after(_FIRST_S):
            while not all(self._samples[topic] for topic in topics):
                await asyncio.sleep(0.05)
        for topic in topics:
            if not self._samples[topic]:
                raise NotFound(f"No message on {named(topic)} within {_FIRST_S:g} s.", "ros2_nav_check may say why.")

    async def why_not(self, odometry: str, radius_m: float) -> str:
        """Say why the robot may not be moved now; "" if it may."""
        speed = (await self._decoded(odometry, self._samples[odometry][-1:]))[0].twist
        ahead, aside_mps, turning = speed_of(speed)
        if math.hypot(ahead, aside_mps) > _MOVES_MPS or abs(turning) > _TURNS_RADPS:
            return f"{named(odometry)} says that it moves already. Wait, or end that with ros2_stop."
        for topic in self._of(SCAN):
            points = await self._points(topic, self._samples[topic][-1])
            if points is None:
                return f"the place of {named(topic)} on the robot is not known (no transform to {named(self._base)})."
            away = [math.hypot(x, y) for x, y in points.tolist()]
            near_m = min((one for one in away if one > radius_m), default=math.inf)
            if near_m < radius_m + _ROOM_M:
                return (
                    f"{named(topic)} sees something at {near_m:.2f} m. It needs {radius_m + _ROOM_M:.2f} m all round, "
                    "as the lidar may be turned. Drive to a freer place with ros2_drive."
                )
        return ""

    async def probe(self, is_turn: bool, since_ns: int) -> Probe:
        """Return the motion since `since_ns`, when the robot stood, as each witness saw it."""
        odometry: dict[str, Motion] = {}
        laser: dict[str, Motion] = {}
        gyro: dict[str, float] = {}
        for topic in self._of(ODOMETRY):
            if motion := await self._by_odometry(topic, since_ns):
                odometry[topic] = motion
        for topic in self._of(SCAN):
            if motion := await self._by_scans(topic, since_ns, is_turn):
                laser[topic] = motion
        for topic in self._of(_IMU) if is_turn else ():
            if (turned := await self._by_gyro(topic, since_ns)) is not None:
                gyro[topic] = turned
        sent = await self._sent(self._command, since_ns, is_turn)
        asked = math.radians(ANGLE_DEG) if is_turn else DISTANCE_M
        return Probe(is_turn=is_turn, commanded=sent or asked, odometry=odometry, laser=laser, gyro=gyro)

    def _of(self, kind: str) -> list[str]:
        return [topic for topic, type_name in self._types.items() if type_name == kind]

    def _ends(self, topic: str, since_ns: int) -> tuple[Sample, Sample] | None:
        """Return the last message before a motion, and the last message of all."""
        before = [one for one in self._samples[topic] if one.received_ns <= since_ns]
        return (before[-1], self._samples[topic][-1]) if before else None

    async def _decoded(self, topic: str, samples: Sequence[Sample]) -> list[Any]:
        messages: list[Any] = await self._robot.values.decode_all(self._types[topic], samples)
        return messages

    async def _by_odometry(self, topic: str, since_ns: int) -> Motion | None:
        ends = self._ends(topic, since_ns)
        if ends is None:
            return None
        before, after = [_pose_of(one) for one in await self._decoded(topic, ends)]
        dx, dy = after[0] - before[0], after[1] - before[1]
        cos, sin = math.cos(before[2]), math.sin(before[2])
        turned = math.remainder(after[2] - before[2], 2 * math.pi)
        return Motion(cos * dx + sin * dy, cos * dy - sin * dx, turned)

    async def _by_scans(self, topic: str, since_ns: int, is_turn: bool) -> Motion | None:
        from ros2_mcp.world.scan_motion import motion_between

        ends = self._ends(topic, since_ns)
        if ends is None:
            return None
        before, after = await self._points(topic, ends[0]), await self._points(topic, ends[1])
        if before is None or after is None:
            return None
        most = (DISTANCE_M, _LEAST_TURN_RAD) if is_turn else (_MOST_SEEN_M, _MOST_SEEN_TURNED_RAD)
        found = await asyncio.to_thread(motion_between, before, after, *most)
        return Motion(found.x_m, found.y_m, found.yaw_rad) if found else None

    async def _points(self, topic: str, sample: Sample) -> Any:
        """Return the points of a scan in the base's frame (n × 2); None without a transform or angles."""
        from ros2_mcp.world.scans import moved, scan_points

        (scan,) = await self._decoded(topic, [sample])
        try:
            mount = await self._mount(str(scan.header.frame_id))
            points = await aside(sample.size, scan_points, scan)
        except RobotError:
            return None
        return moved(points.hits, mount)[:, :2]

    async def _mount(self, frame: str) -> Pose:
        frame = frame.lstrip("/")
        return Pose() if frame == self._base.lstrip("/") else (await pose_in(Live(self._robot), self._base, frame)).pose

    async def _by_gyro(self, topic: str, since_ns: int) -> float | None:
        """Return the angle turned about the base's z axis, without the bias that the gyro had while the robot stood."""
        samples = list(self._samples[topic])  # more arrive while they are decoded
        messages = await self._decoded(topic, samples)
        if not messages:
            return None
        try:
            mount = await self._mount(str(messages[0].header.frame_id))
        except RobotError:
            mount = Pose()
        rates = [_about_z(one.angular_velocity, mount) for one in messages]
        at_rest = [rate for sample, rate in zip(samples, rates, strict=True) if sample.received_ns <= since_ns]
        if not at_rest:
            return None
        bias = sum(at_rest[-50:]) / len(at_rest[-50:])
        return _summed([(one.received_ns, rate - bias) for one, rate in zip(samples, rates, strict=True)], since_ns)

    async def _sent(self, topic: str, since_ns: int, is_turn: bool) -> float:
        """Return how far the commands since then ask for, in m or rad; 0.0 if none were received."""
        samples = list(self._samples[topic])  # more arrive while they are decoded
        speeds = [speed_of(one) for one in await self._decoded(topic, samples)]
        rates = [speed[2] if is_turn else speed[0] for speed in speeds]
        return _summed([(one.received_ns, rate) for one, rate in zip(samples, rates, strict=True)], since_ns)


def _summed(rates: Sequence[tuple[int, float]], since_ns: int) -> float:
    """Return the integral of (time in ns, rate per s) since a time; a gap counts as `_LONGEST_STEP_S`."""
    later = [one for one in rates if one[0] > since_ns]
    steps = [min((after[0] - before[0]) / 1e9, _LONGEST_STEP_S) for before, after in pairwise(later)]
    return sum(step * rate for step, (_, rate) in zip(steps, later, strict=False))


def _about_z(velocity: Any, mount: Pose) -> float:
    return rotated(mount.rotation, (float(velocity.x), float(velocity.y), float(velocity.z)))[2]


def _pose_of(odometry: Any) -> tuple[float, float, float]:
    pose = odometry.pose.pose
    q = pose.orientation
    return float(pose.position.x), float(pose.position.y), yaw_rad(q.x, q.y, q.z, q.w)
