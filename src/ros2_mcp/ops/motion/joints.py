"""Move joints by name through a trajectory controller, within the URDF's limits, until the joint states agree."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from time import monotonic
from typing import Any, Literal, cast

import anyio

from ros2_mcp.guard.policy import bounded
from ros2_mcp.model.commands import Publish, SendGoal
from ros2_mcp.model.errors import (
    LEASE,
    BadInput,
    LinkError,
    NotFound,
    Refused,
    RobotError,
    Stopped,
    TimedOut,
    latch_set_by,
)
from ros2_mcp.model.goals import new_goal_id
from ros2_mcp.model.names import did_you_mean
from ros2_mcp.model.text import listed, named, quoted
from ros2_mcp.ops.acting.endings import ended_by
from ros2_mcp.ops.acting.idle import why_idle, with_reason
from ros2_mcp.ops.acting.servers import check_one_server
from ros2_mcp.ops.actions.result import result_of
from ros2_mcp.ops.actions.status import SERVER_S, states_now
from ros2_mcp.ops.log.complaints import Complaints, complaints_from_now
from ros2_mcp.ops.motion.controllers import FOLLOW, TRAJECTORY, Controller, controller_for
from ros2_mcp.ops.motion.joint_states import JointStates, joint_states
from ros2_mcp.ops.results.results import SAID, Report, silent
from ros2_mcp.ops.space.description import described
from ros2_mcp.robot import Robot
from ros2_mcp.robot.goals import Goal
from ros2_mcp.robot.jobs import Job
from ros2_mcp.robot.session import Session
from ros2_mcp.world.urdf import Joint, Urdf

DEFAULT_SPEED = 0.3
"""The default share of a joint's own velocity limit: slow enough to be watched."""
MIN_SPEED, MAX_JOINTS = 0.01, 64
MIN_TOLERANCE, MAX_TOLERANCE, DEFAULT_TOLERANCE = 0.0005, 0.5, 0.02
"""In rad or m. Controllers are accurate to about a hundredth."""
MIN_S, MAX_S = 0.3, 600.0
"""A move takes at least the first of these, so that even a small step is no jerk."""
_PEAK = 1.5
"""The maximum speed of a cubic from rest to rest, relative to its mean speed."""
_ACCEPT_S = 10.0
"""Time for the controller to accept the goal, as for any goal (`ops/actions/send_goal.py`)."""
_MATCH_S = 1.0
"""Time for subscribers to match, as in `ops/topics/publish.py`."""
_LOOK_S, _STILL_LOOKS = 0.05, 4
"""A joint has arrived when it was within its tolerance, and stationary, in four checks in a row."""
_SLEPT_S = 0.5
"""If a check comes later than this, the process was stopped, or its machine slept. Half of the link lease."""
_SILENT_S = 1.0
"""Without joint states for this long, the positions of the joints are unknown. Ten joint states at 10 Hz."""
_PATIENCE, _ROOM_S = 1.5, 3.0
"""The time limit is the planned time times the first, and the second for settling."""
_END_S = 3.0
"""Time to end what was started; a live bridge and controller need milliseconds."""
_SETTLES_S = 1.0
_RESULT_S = 0.2
"""Time for the result of a goal whose joints were seen to arrive, or are no longer
reported: it is mostly on its way."""
_RIVALS_S = 0.2
"""Time to read the goals that the controller has: its status is latched, and comes within milliseconds of matching."""
_GOING = (1, 2, 3)
"""Accepted, executing and cancelling, in action_msgs/msg/GoalStatus."""
_NOT_MOVED = ("aborted", "timeout", "silent")
"""Outcomes whose reason may be in the robot's log, or in the states of its controllers."""
_ROUNDED = 1e-6
_CODES: Mapping[int, str] = {
    -1: "invalid goal",
    -2: "invalid joints",
    -3: "its time stamp is in the past",
    -4: "a path tolerance was violated",
    -5: "a goal tolerance was violated",
}
"""`error_code` of control_msgs/action/FollowJointTrajectory."""


@dataclass(frozen=True, slots=True, kw_only=True)
class JointRequest:
    """The targets of joints: in rad, in m for prismatic joints; with `relative`, from their present positions. `speed`
    is the share of each joint's velocity limit; `duration_s` is the duration of the move instead.
    """

    joints: Mapping[str, float]
    relative: bool = False
    speed: float | None = None
    duration_s: float | None = None
    tolerance: float = DEFAULT_TOLERANCE
    controller: str = ""


@dataclass(frozen=True, slots=True)
class JointResult:
    """One joint: its `start`, `target` and `measured` position, and the `error` (target - measured), all in `unit` (rad
    or m).
    """

    name: str
    start: float
    target: float
    measured: float
    error: float
    unit: str


JointsEnd = Literal["reached", "silent", "timeout", "aborted", "rejected", "no_subscriber", "interrupted"]


@dataclass(frozen=True, slots=True, kw_only=True)
class JointsMoved:
    """The result of a joint motion.

    `outcome` is `reached`, or why the motion ended early: `silent` (no joint states), `timeout`, `aborted` (by the
    controller), `rejected` (by the controller), `no_subscriber`, `interrupted` (by a stop, for example); `note` has the
    details. `interface` is the action or topic that was used.
    """

    outcome: JointsEnd = field(metadata=SAID)
    joints: Sequence[JointResult]
    controller: str
    interface: str
    planned_s: float
    elapsed_s: float = field(metadata=SAID)
    note: str = ""

    @property
    def has_failed(self) -> bool:
        """Return whether the joints did not arrive. A move that a stop ended has not failed."""
        return self.outcome not in ("reached", "interrupted")

    def summary(self) -> str:
        """Return the result in one line."""
        moved = ", ".join(
            f"{named(one.name)} at {one.measured:.3f} {one.unit} (target {one.target:.3f})" for one in self.joints[:8]
        )
        return f"{self.outcome} in {self.elapsed_s:.1f} s: {moved}. {self.note}".rstrip()


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """A checked move: `targets` of the requested joints, `all_targets` of all joints of the controller."""

    controller: Controller
    starts: Mapping[str, float]
    targets: Mapping[str, float]
    all_targets: Mapping[str, float]
    units: Mapping[str, str]
    planned_s: float
    tolerance: float

    @property
    def trajectory(self) -> Mapping[str, Any]:
        """A trajectory_msgs/msg/JointTrajectory of one point, at which the joints are at rest."""
        seconds = int(self.planned_s)
        at = {"sec": seconds, "nanosec": int((self.planned_s - seconds) * 1e9)}
        point = {
            "positions": list(self.all_targets.values()),
            "velocities": [0.0] * len(self.all_targets),
            "time_from_start": at,
        }
        return {"joint_names": list(self.all_targets), "points": [point]}


async def move_joints(robot: Robot, session: Session, request: JointRequest, report: Report = silent) -> JointsMoved:
    """Move joints, and return when they have arrived, or the move has ended early.

    Raises:
        BadInput: for joints that do not exist, or positions or speeds beyond the limits of the URDF.
        NotFound: if there is no description or no controller, or no joint states report the joints.
        Refused: if the policy forbids it, or another motion moves the controller.
        Stopped: if a stop came before anything was sent.
    """
    check_request(request)
    urdf = await described(robot)
    wanted = [joint_of(urdf, name) for name in request.joints]
    controller = await controller_for(robot, [joint.name for joint in wanted], request.controller)
    async with joint_states(robot) as states:
        try:
            plan = await planned_move(request, wanted, controller, states)
        except NotFound as error:  # no joint states: mostly the controllers are not active either
            raise await with_reason(robot, error, feedback=states.topics[0], action=controller.action) from error
        motion = JointMotion(robot, session, plan, states)

        async def progress() -> None:
            if motion.is_running:
                await report(min(motion.elapsed_s, plan.planned_s), plan.planned_s, motion.line())

        await robot.jobs.run(motion, every_second=progress)
        if not (motion.has_left or motion.outcome_word):
            if motion.is_stopping:
                raise Stopped(
                    f"{ended_by(motion.stop_reason or 'a stop')} Nothing was sent to {named(controller.name)}."
                )
            raise LinkError(f"The move by {named(controller.name)} ended; its outcome is unknown.")
        return motion.result()


def check_request(request: JointRequest) -> None:
    """Raise `BadInput` or `BadValue` for an impossible move of joints."""
    if not request.joints:
        raise BadInput("No joints are given.", 'Give joints such as {"elbow_joint": 0.5}, in rad or m.')
    bounded("joints", len(request.joints), 1, MAX_JOINTS, "joints")
    if request.speed is not None and request.duration_s is not None:
        raise BadInput("Give either speed or duration_s.", "One follows from the other.")
    if request.speed is not None:
        bounded("speed", request.speed, MIN_SPEED, 1.0, "of the velocity limit")
    if request.duration_s is not None:
        bounded("duration_s", request.duration_s, MIN_S, MAX_S, "s")
    bounded("tolerance", request.tolerance, MIN_TOLERANCE, MAX_TOLERANCE, "rad or m")


def joint_of(urdf: Urdf, name: str) -> Joint:
    """Return a joint that can be moved on its own. Raises `BadInput` for any other."""
    moving = [joint.name for joint in urdf.moving]
    joint = urdf.joints.get(name)
    if joint is None:
        shown = f"The joints are {listed(moving, 16)}."
        raise BadInput(f"The robot has no joint {quoted(name)}.", did_you_mean(name, moving, shown))
    if joint.mimic:
        raise BadInput(f"{named(name)} follows {named(joint.mimic.joint)}: move that.")
    if not joint.moves:
        raise BadInput(f"{named(name)} is fixed: it cannot be moved.", f"The joints are {listed(moving, 16)}.")
    return joint


async def planned_move(
    request: JointRequest, wanted: Sequence[Joint], controller: Controller, states: JointStates
) -> Plan:
    """Return the move, checked against limits and speed. Raises `BadInput` or `NotFound`."""
    every = list(dict.fromkeys((*controller.joints, *request.joints)))
    await states.wait_for(every)
    here = dict(zip(every, states.of(every), strict=True))
    targets = {name: here[name] * request.relative + value for name, value in request.joints.items()}
    least_s, planned_s = MIN_S, MIN_S
    for joint in wanted:
        gap, limits = abs(targets[joint.name] - here[joint.name]), joint.limits
        _check_limits(joint, targets[joint.name])
        if limits.velocity:
            least_s = max(least_s, _PEAK * gap / limits.velocity)
            planned_s = max(planned_s, _PEAK * gap / limits.velocity / (request.speed or DEFAULT_SPEED))
        elif request.duration_s is None and gap > request.tolerance:
            raise BadInput(f"The URDF gives no velocity limit for {named(joint.name)}.", "Give duration_s.")
    if request.duration_s is not None:
        planned_s = request.duration_s
        if planned_s < least_s - _ROUNDED:
            raise BadInput(
                f"{planned_s:g} s is faster than the joints' velocity limits.", f"Give at least {least_s:.2f} s."
            )
    if planned_s > MAX_S:
        raise BadInput(f"At this speed it takes {planned_s:.0f} s, more than {MAX_S:g} s.", "Give a higher speed.")
    return Plan(
        controller=controller,
        starts={name: here[name] for name in targets},
        targets=targets,
        all_targets={**{name: here[name] for name in every}, **targets},
        units={joint.name: joint.unit for joint in wanted},
        planned_s=planned_s,
        tolerance=request.tolerance,
    )


def _check_limits(joint: Joint, target: float) -> None:
    if not joint.limits.known:
        problem = (
            f"{named(joint.name)}: its limits are unknown, because they are not numbers in the robot's description."
        )
        raise BadInput(
            problem, "Correct the limits in the URDF: without them nothing keeps the joint within its range."
        )
    lower = -math.inf if joint.limits.lower is None else joint.limits.lower
    upper = math.inf if joint.limits.upper is None else joint.limits.upper
    if not lower - _ROUNDED <= target <= upper + _ROUNDED:
        bounds = f"{lower:g} to {upper:g} {joint.unit}"
        raise BadInput(
            f"{named(joint.name)}: {target:g} {joint.unit} is beyond its limits.", f"The URDF allows {bounds}."
        )


@dataclass(slots=True)
class _Watched:
    """The positions at the last check, and the number of checks in a row in which the joints had arrived."""

    positions: list[float] = field(default_factory=list[float])
    arrived: int = 0


class JointMotion(Job):
    """A move whose call waits for its end. While it runs, no other motion may move the same controller."""

    kind = "motion"
    most_running = 16
    """A robot has few controllers; each takes one motion at a time."""

    def __init__(self, robot: Robot, session: Session, plan: Plan, states: JointStates) -> None:
        super().__init__(owner=session.principal, moves=[plan.controller.interface])
        self._robot, self._session = robot, session
        self._plan = plan
        self._states = states
        self._goal_id = new_goal_id()
        self._failed = ""
        self._has_result = anyio.Event()
        self.notes: list[str] = []
        self.has_left = False
        self.outcome_word = ""
        self.why = ""

    def check_beside(self, running: Sequence[Job]) -> None:
        """Raise `Refused` if another motion moves this controller."""
        for job in running:
            if isinstance(job, JointMotion) and job._plan.controller.name == self._plan.controller.name:
                raise Refused(
                    f"{job.id} already moves {named(job._plan.controller.name)}.",
                    "Wait until it ends, or end it with ros2_stop.",
                )

    async def run(self) -> None:
        """Command the controller, and check the joints until they have arrived, or the move has to end."""
        self.begun()
        complaints = complaints_from_now(self._robot)
        try:
            if self._plan.controller.action:
                await self._by_action(complaints)
            else:
                await self._by_topic()
        finally:
            if self.has_left and self.outcome_word != "reached":
                with anyio.CancelScope(shield=True), anyio.move_on_after(_END_S):
                    await self._hold()
        if self.outcome_word in _NOT_MOVED:  # after the hold, because it waits for log lines
            self.why = f"{self.why} {await complaints.said()}".rstrip()

    def line(self) -> str:
        """Return the progress in words."""
        worst = max(self._plan.targets, key=self._gap)
        return f"{named(worst)} is {self._gap(worst):.3f} {self._plan.units[worst]} from its target"

    def result(self) -> JointsMoved:
        """Return the result of the move."""
        plan = self._plan
        rows = [
            JointResult(
                name, plan.starts[name], target, measured := self._measured(name), target - measured, plan.units[name]
            )
            for name, target in plan.targets.items()
        ]
        word, why = self.outcome_word, self.why
        if not word:
            word, why = "interrupted", ended_by(self.stop_reason or "a request to cancel it")
        return JointsMoved(
            outcome=cast("JointsEnd", word),
            joints=rows,
            controller=plan.controller.name,
            interface=plan.controller.interface,
            planned_s=round(plan.planned_s, 3),
            elapsed_s=round(self.elapsed_s, 3),
            note=" ".join(filter(None, (why, *self.notes))),
        )

    async def _by_action(self, complaints: Complaints) -> None:
        action, robot = self._plan.controller.action, self._robot
        command = SendGoal(
            principal=self.owner,
            name=action,
            type=FOLLOW,
            value={"trajectory": self._plan.trajectory},
            goal_id=self._goal_id,
            timeout_s=_ACCEPT_S,
            wait_s=SERVER_S,
        )
        await robot.values.learn(FOLLOW)
        await check_one_server(robot, action, "End all but one, or send it with ros2_send_action_goal and force=true.")
        await self._note_rivals(action)
        self.has_left = True
        try:
            answer = await robot.fields_of(await robot.do(command, self._session))
        except (NotFound, TimedOut) as error:
            raise await with_reason(robot, error, action=action) from error
        if not answer["accepted"]:
            why = [await why_idle(robot, action=action), await complaints.said()]
            said = " ".join(filter(None, why)) or "ros2_log_read may show why."
            self._end("rejected", f"The controller rejected the goal. {said}")
            return
        async with anyio.create_task_group() as group:
            group.start_soon(self._await_result, action)
            await self._watch()
            if self.outcome_word != "interrupted":
                with anyio.move_on_after(_RESULT_S):  # a goal that has just succeeded is not cancelled
                    await self._has_result.wait()
            group.cancel_scope.cancel()
        if self._failed and self._failed not in self.why:
            self.why = f"{self.why} {self._failed}".lstrip()
        if self.outcome_word in _NOT_MOVED:
            why_not = await why_idle(robot, feedback=self._states.topics[0], action=action, is_in_doubt=True)
            self.why = f"{self.why} {why_not}".rstrip()

    async def _note_rivals(self, action: str) -> None:
        """Note the goals of other clients that this goal replaces: a controller follows one goal at a time."""
        for state in await states_now(self._robot, action, _RIVALS_S):
            if state.status_code in _GOING and not self._robot.jobs.get(Goal, state.goal_id):
                self.notes.append(f"It replaced goal {state.goal_id} of another client, which was {state.status}.")

    async def _await_result(self, action: str) -> None:
        """Wait for the result, and note why the controller ended the goal if it did not succeed."""
        try:
            ended = await result_of(self._robot, action, FOLLOW, self._goal_id, MAX_S * 2)
        except RobotError as error:
            self._failed = str(error)
            return
        finally:
            self._has_result.set()
        if ended.status != "SUCCEEDED":
            told: Mapping[str, Any] = ended.result or {}
            code, text = int(told.get("error_code", 0)), str(told.get("error_string", ""))
            reason = ", ".join(filter(None, (_CODES.get(code, ""), quoted(text) if text else "")))
            self._failed = f"The controller ended the goal as {ended.status}{': ' + reason if reason else ''}."

    async def _by_topic(self) -> None:
        to = await self._robot.types.destination(self._plan.controller.topic, TRAJECTORY)
        command = Publish(
            principal=self.owner,
            name=to.topic,
            type=to.type,
            value=self._plan.trajectory,
            choice=to.choice,
            wait_match_s=_MATCH_S,
        )
        self.has_left = True
        sent = await self._robot.do(command, self._session)
        if not sent.matched:
            self._end("no_subscriber", f"No subscriber received the trajectory on {named(to.topic)}.")
            return
        await self._watch()
        if self.outcome_word == "reached":
            self._robot.failsafes.settled(to.topic, to.type)

    async def _watch(self) -> None:
        """Check the joints until they have arrived, or something is wrong."""
        names, watched = list(self._plan.targets), _Watched()
        began = looked = awake = monotonic()
        deadline = began + _PATIENCE * self._plan.planned_s + _ROOM_S
        while not self.outcome_word:
            await anyio.sleep(_LOOK_S)
            looked, before = monotonic(), looked
            awake = looked if looked - before > _SLEPT_S else awake
            age_s = min(self._states.age_s(names), looked - awake)  # nothing could be received before it was awake
            latch = self._robot.guard.latch.look()
            if latch.is_set:  # the bridge has ended the move, and may not have reported the cause yet
                by = f"{named(latch.by)}: {quoted(latch.reason)}" if latch.by else ""
                self._end("interrupted", ended_by(latch_set_by(by)))
            elif self._robot.graph.lapsed_at > began:
                self._end("interrupted", ended_by(LEASE))
            elif age_s > _SILENT_S:
                self._end(
                    "silent", f"No joint state was received for {age_s:.1f} s: the joints were commanded to hold."
                )
            elif self._failed:
                self._end("aborted", f"{self._failed} {self._where()}")
            elif self._has_arrived(watched, names):
                self._end("reached", "")
            elif monotonic() > deadline:
                self._end("timeout", f"{self._where()} The joints were commanded to hold.")

    def _has_arrived(self, watched: _Watched, names: Sequence[str]) -> bool:
        positions = self._states.of(names)
        moved = max(
            (abs(now - then) for now, then in zip(positions, watched.positions, strict=False)), default=math.inf
        )
        watched.positions = positions
        is_there = all(self._gap(name) <= self._plan.tolerance for name in names)
        watched.arrived = watched.arrived + 1 if is_there and moved < self._plan.tolerance / 4 else 0
        return watched.arrived >= _STILL_LOOKS

    async def _stood(self) -> None:
        """Wait until the joints are stationary, so that the result has their final positions. At most a second: a hold
        brakes within tenths of one.
        """
        names, before = list(self._plan.targets), list[float]()
        with anyio.move_on_after(_SETTLES_S):
            while (now := self._states.of(names)) != before:
                near = [abs(here - there) < self._plan.tolerance / 4 for here, there in zip(now, before, strict=False)]
                if near and all(near):
                    return
                before = now
                await anyio.sleep(2 * _LOOK_S)

    def _where(self) -> str:
        """Return a sentence on the joint that is farthest from its target, and whether it has moved."""
        worst = max(self._plan.targets, key=self._gap)
        moved = abs(self._measured(worst) - self._plan.starts[worst])
        how = "has not moved" if moved < self._plan.tolerance / 4 else f"has moved by {moved:.3f}"
        unit = self._plan.units[worst]
        return f"{named(worst)} {how} and is {self._gap(worst):.3f} {unit} from its target: it may be blocked."

    def _gap(self, name: str) -> float:
        return abs(self._plan.targets[name] - self._measured(name))

    def _measured(self, name: str) -> float:
        return self._states.positions[name].position

    def _end(self, word: str, why: str) -> None:
        self.outcome_word, self.why = word, why

    async def _hold(self) -> None:
        """End what may still be moving: cancel the goal, or, on a topic, hold the joints where they are."""
        try:
            if self._plan.controller.action:
                goal = self._robot.jobs.get(Goal, self._goal_id)
                if goal and goal.is_running:
                    await goal.request_cancel(_END_S)
            else:
                await self._robot.zero([self._plan.controller.topic])
            await self._stood()
        except RobotError as error:
            self.why = f"{self.why} NOT confirmed that the joints have stopped: {error}".strip()
