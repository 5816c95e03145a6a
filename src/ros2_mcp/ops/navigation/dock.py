"""`ros2_nav_dock`: dock or undock with Nav2's docking server, and measure what came of it: pose, motion, battery."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from time import monotonic
from typing import Any, Literal

import anyio

from ros2_mcp.guard.policy import bounded
from ros2_mcp.model.errors import BadInput, NotFound, RobotError
from ros2_mcp.model.goals import STATUS, TERMINAL, goal_id_hex
from ros2_mcp.model.names import did_you_mean
from ros2_mcp.model.nav2 import BELOW, CODES, DOCK, NAVIGATORS, UNDOCK, in_words
from ros2_mcp.model.text import counted, named, quoted
from ros2_mcp.ops.acting.endings import ended_by
from ros2_mcp.ops.actions.send_goal import GoalOutcome, follow, send_goal
from ros2_mcp.ops.actions.status import states_now
from ros2_mcp.ops.log.complaints import Complaints, complaints_from_now
from ros2_mcp.ops.navigation.below import idle_server, settle, why_lost
from ros2_mcp.ops.navigation.docks import Battery, Dock, battery_of, docks_of
from ros2_mcp.ops.navigation.known_places import places_of
from ros2_mcp.ops.navigation.last_pose import note_last_pose
from ros2_mcp.ops.navigation.navigate import action_of
from ros2_mcp.ops.navigation.targets import Target, targets_of
from ros2_mcp.ops.navigation.whereabouts import Whereabouts, whereabouts
from ros2_mcp.ops.results.results import SAID, Report, reporting, silent
from ros2_mcp.robot import Robot
from ros2_mcp.robot.goals import CANCELLED_S, Goal
from ros2_mcp.robot.kept import Kept
from ros2_mcp.robot.listening import Listening
from ros2_mcp.robot.session import Session
from ros2_mcp_common.wire.limits import MAX_DURATION_S

Outcome = Literal["docked", "undocked", "under way", "failed", "rejected", "canceled"]
STATES: Mapping[int, str] = {
    1: "drives to the staging pose",
    2: "looks for the dock",
    3: "drives to the dock",
    4: "waits until it charges",
    5: "tries again",
}
"""States of the feedback of DockRobot."""
_STAGING_S, _UNDOCKING_S = 1000.0, 30.0
"""Defaults of the actions' definitions."""
_SILENT_S, _LOOK_S = 5.0, 1.0
"""A docking server sends feedback at the rate of its controller; while the navigator drives, some send none. After this
silence the server checks whether it still runs."""
_FIRST_S, _ANNOUNCED_S = 3.0, 0.1
"""Waits for the first feedback of a goal, and for the subscription to be announced (see `send_goal`)."""
_SETTLE_S = 30.0
_MOST_KEPT = 20
_TRANSFORMS_S = 0.3
_ENDINGS = frozenset(STATUS[code] for code in TERMINAL)


@dataclass(frozen=True, slots=True, kw_only=True)
class NavDocked:
    """The state or outcome of docking or undocking. `job_id` is the job that continues while it is `under way`.

    `states` are those that were seen, in order; `retries` is Nav2's count. `error` is Nav2's error code in words.
    `away_m` and `heading_off_deg` are the robot's distance and heading difference from the dock's pose, `moved_m` is
    how far it moved by odometry (null: not known). `is_charging` and `battery` are what the battery's topic reports,
    independently of Nav2 (null: not known).
    """

    outcome: Outcome = field(metadata=SAID)
    dock: str = field(metadata=SAID)
    action_name: str
    job_id: str
    duration_s: float = field(metadata=SAID)
    states: Sequence[str] = field(metadata=SAID)
    retries: int = 0
    error: str = field(default="", metadata=SAID)
    away_m: float | None = None
    heading_off_deg: float | None = None
    moved_m: float | None = None
    is_charging: bool | None = None
    battery: str = field(default="", metadata=SAID)
    helps: str = field(default="", metadata=SAID)
    note: str = field(default="", metadata=SAID)

    @property
    def has_failed(self) -> bool:
        """Whether it has ended without success. What is under way or was cancelled has not failed."""
        return self.outcome in ("failed", "rejected")

    def summary(self) -> list[str]:
        """Return the outcome, what was measured, and the cause of a failure."""
        dock = f" ({self.dock})" if self.dock else ""
        lines = [f"{self.outcome}{dock} after {self.duration_s:.1f} s. {self.note}".strip()]
        if self.error:
            lines.append(f"Nav2 says: {self.error}.")
        if self.states:
            retries = f"; {counted(self.retries, 'retry', 'retries')}" if self.retries else ""
            lines.append(f"It went through: {', '.join(self.states)}{retries}.")
        measured: list[str] = []
        if self.away_m is not None:
            turned = "" if self.heading_off_deg is None else f" and {abs(self.heading_off_deg):.0f}°"
            measured.append(f"{self.away_m:.2f} m{turned} from the dock's pose")
        if self.moved_m is not None:
            measured.append(f"moved {self.moved_m:.2f} m by odometry")
        if self.battery:
            measured.append(self.battery)
        lines += [f"Measured: {'; '.join(measured)}."] if measured else ["Nothing could be measured."]
        return [*lines, *([f"What would help: {self.helps}"] if self.helps else [])]


@dataclass(frozen=True, slots=True, kw_only=True)
class DockRequest:
    """The dock: a name that the server knows, or `at` its pose, with its type. Or `undock`."""

    dock: str = ""
    at: object = None
    dock_type: str = ""
    undock: bool = False
    job_id: str = ""
    action: str = ""


async def dock(
    robot: Robot, session: Session, request: DockRequest, timeout_s: float = 45.0, report: Report = silent
) -> NavDocked:
    """Dock or undock, or wait for it; wait at most `timeout_s`, after which it continues. Cancelling this call cancels
    the goal.

    Raises:
        BadInput: for arguments that contradict each other, a dock that the server does not know, or if it knows several
            and none is given.
        NotFound: without a docking server, or for an unknown job.
        RobotError: what sending the goal raises.
    """
    bounded("timeout_s", timeout_s, 0.0, MAX_DURATION_S, "s")
    if request.job_id:
        goal = robot.jobs.find(Goal, request.job_id)
        if goal.action_type not in (DOCK, UNDOCK):
            raise NotFound(f"The job {quoted(request.job_id)} is not a docking job.", "ros2_action_status lists goals.")
        attempt = robot.kept.get(_Attempts, _Attempts).find(goal.id)
        attempt = attempt or _Attempt(robot, session, goal.action, goal.action_type)
        return await attempt.wait(goal, timeout_s, report)
    if request.undock and (request.dock or request.at is not None):
        raise BadInput("Undocking needs no dock.", "Give undock=true alone, with dock_type if Nav2 asks for it.")
    kind = UNDOCK if request.undock else DOCK
    action = await action_of(robot, kind, request.action)
    if idle := await idle_server(robot, action):
        raise NotFound(f"Nothing was sent: {idle}", "")
    attempt = _Attempt(robot, session, action, kind)
    value = {"dock_type": request.dock_type, "max_undocking_time": _UNDOCKING_S}
    if kind == DOCK:
        value = await attempt.choose(request)
    await attempt.begin()
    # Subscribed before the goal is sent: of the drive to the dock's place some servers send one feedback only.
    async with robot.listen(f"{action}/_action/feedback", f"{kind}_FeedbackMessage") as listening:
        await states_now(robot, action, _ANNOUNCED_S)
        sent = await send_goal(robot, session, action, kind, value)
        if not sent.accepted:
            return await attempt.result("rejected", sent)
        goal = robot.jobs.get(Goal, sent.goal_id)
        if goal is None:
            raise NotFound("This server no longer tracks that goal.", "ros2_action_status lists the goals.")
        robot.kept.get(_Attempts, _Attempts).keep(goal.id, attempt)
        return await attempt.wait(goal, timeout_s, report, listening)


class _Attempt:
    """Follows one docking or undocking goal: keeps the robot's pose before it and what Nav2 reports, and makes the
    result.
    """

    def __init__(self, robot: Robot, session: Session, action: str, kind: str) -> None:
        self._robot, self._session, self._action, self._kind = robot, session, action, kind
        self._dock: Dock | None = None
        self._before: Whereabouts | None = None
        self._complaints: Complaints = complaints_from_now(robot)
        self._states: list[str] = []
        self._retries = 0
        self._began_at = self._heard_at = monotonic()
        self._lost = ""

    async def choose(self, request: DockRequest) -> dict[str, Any]:
        """Return the goal of docking, at a dock that the server knows or at a pose."""
        goal: dict[str, Any] = {
            "dock_type": request.dock_type,
            "max_staging_time": _STAGING_S,
            "navigate_to_staging_pose": True,
        }
        if request.at is not None:
            if request.dock:
                raise BadInput("`dock` is a name, and `at` is a pose instead.", "Give one of the two.")
            (target, *more) = targets_of(request.at, places_of(self._robot))
            if more or target.yaw_rad is None:
                raise BadInput("The pose of one dock is needed, with its heading.", "Give yaw_deg, too.")
            self._dock = _dock_at(target, request.dock_type)
            return {**goal, "use_dock_id": False, "dock_id": "", "dock_pose": target.pose()}
        known = await docks_of(self._robot, self._action)
        name = request.dock
        if known is not None:
            by_name = {one.name: one for one in known}
            names = ", ".join(map(named, by_name))
            if not name and len(by_name) > 1:
                raise BadInput(f"There are several docks: {names}.", "Give dock.")
            name = name or next(iter(by_name))
            if name not in by_name:
                hint = did_you_mean(name, list(by_name), "Give one of them.")
                raise BadInput(f"The docking server knows no dock {quoted(name)}, only {names}.", hint)
            self._dock = by_name[name]
        elif not name:
            raise BadInput(
                "The docks are not among the parameters of the docking server.", "Give the name of a dock as `dock`."
            )
        return {**goal, "use_dock_id": True, "dock_id": name, "dock_pose": Target("", "map", 0.0, 0.0, 0.0).pose()}

    async def begin(self) -> None:
        """Note where the robot is."""
        self._before = await whereabouts(self._robot, "odom")
        self._began_at = monotonic()

    async def wait(self, goal: Goal, timeout_s: float, report: Report, first: Listening | None = None) -> NavDocked:
        """Wait for the end of the goal, or for `timeout_s`. `first` has the feedback since before it was sent."""
        self._heard_at = monotonic()
        ended: GoalOutcome | None = None
        try:
            with anyio.move_on_after(timeout_s) as waiting:
                async with reporting(report, timeout_s, self._line), anyio.create_task_group() as group:
                    group.start_soon(self._watch_server, group.cancel_scope)
                    if first:
                        group.start_soon(self._hear_first, first, goal.id)
                    try:
                        while ended is None or ended.status == "TIMEOUT":
                            ended = await follow(self._robot, goal, heard=self._hear)
                    except RobotError as error:
                        self._lost = error.message
                    group.cancel_scope.cancel()
        except asyncio.CancelledError:  # a caller who cancels wants the robot to stand
            with anyio.CancelScope(shield=True):
                await self._give_up(goal)
            raise
        if ended and ended.status in _ENDINGS:
            return await self._judged(goal, ended)
        if self._lost:
            return await self._settled(goal)
        assert waiting.cancelled_caught
        doing = self._states[-1] if self._states else "no feedback yet"
        waits = f'Wait with ros2_nav_dock(job_id="{goal.id}"); ros2_stop ends it.'
        return await self.result("under way", None, goal.id, f"Now: {doing}. {waits}")

    async def _give_up(self, goal: Goal) -> None:
        if goal.is_running:
            with suppress(RobotError):
                await goal.request_cancel(CANCELLED_S)

    async def _watch_server(self, following: anyio.CancelScope) -> None:
        """Stop following a goal whose server sends no feedback and does not answer."""
        while True:
            await asyncio.sleep(_LOOK_S)
            if min(monotonic() - self._heard_at, self._robot.graph.bridge_age_s) < _SILENT_S:
                continue
            if why := await why_lost(self._robot, self._action):
                self._lost = why
                following.cancel()
                return
            self._heard_at = monotonic()

    async def _hear_first(self, listening: Listening, goal_id: str) -> None:
        """Take the first feedback, which may come before the goal is followed."""
        with suppress(RobotError):
            for sample in await listening.take(_FIRST_S):
                message = (await self._robot.values.render(listening.type, sample.data)).value
                if goal_id_hex(message["goal_id"]["uuid"]) == goal_id and not self._states:
                    self._hear(message["feedback"])
            await listening.end()

    def _hear(self, feedback: Mapping[str, Any]) -> None:
        self._heard_at = monotonic()
        state, retries = feedback.get("state"), feedback.get("num_retries")
        if isinstance(retries, int):
            self._retries = max(self._retries, retries)
        if isinstance(state, int) and state in STATES and self._states[-1:] != [STATES[state]]:
            self._states.append(STATES[state])

    def _line(self) -> str:
        verb = "docking" if self._kind == DOCK else "undocking"
        doing = self._states[-1] if self._states else "no feedback yet"
        again = f", {counted(self._retries, 'retry', 'retries')}" if self._retries else ""
        return f"{verb}: {doing}{again}"

    async def _judged(self, goal: Goal, ended: GoalOutcome) -> NavDocked:
        if ended.status == "CANCELED":
            reason = goal.stop_reason or "a request to cancel it"
            return await self.result("canceled", ended, goal.id, ended.note or ended_by(reason))
        successful = ended.status == "SUCCEEDED" and bool((ended.result or {}).get("success", True))
        if not successful:
            return await self.result("failed", ended, goal.id)
        done: Outcome = "docked" if self._kind == DOCK else "undocked"
        return await self.result(done, ended, goal.id)

    async def _settled(self, goal: Goal) -> NavDocked:
        """After the server was lost: end what runs below it, and wait until the robot stands."""
        said = f"{self._lost[0].upper()}{self._lost[1:].rstrip('.')}."
        kinds = BELOW | NAVIGATORS
        below = await settle(self._robot, self._session, self._action, lambda _: None, _SETTLE_S, kinds)
        return await self.result("failed", None, goal.id, f"{said} {below.sentence}")

    async def result(self, outcome: Outcome, ended: GoalOutcome | None, job_id: str = "", note: str = "") -> NavDocked:
        """Measure where the robot is and whether it charges, and return all that is known."""
        took_s = monotonic() - self._began_at
        expected = {"docked": True, "undocked": False}.get(outcome)
        battery, away, moved = await asyncio.gather(
            battery_of(self._robot, expected), self._away(outcome), self._moved()
        )
        if outcome not in ("under way", "rejected"):
            await note_last_pose(self._robot)
        result = (ended.result if ended else None) or {}
        code, text = int(result.get("error_code") or 0), str(result.get("error_msg") or "")
        notes, helps = [note], ""
        if outcome in ("failed", "rejected"):
            notes += [ended.note if ended and not code else "", await self._complaints.said()]
            helps = CODES[code].helps if code in CODES else "ros2_nav_check shows whether Nav2 is well."
        elif outcome == "docked":
            notes.append(_doubt(battery))
        elif outcome == "undocked" and battery and battery.is_charging:
            notes.append("The battery is STILL being charged: the robot may stand at the dock.")
        return NavDocked(
            outcome=outcome,
            dock=self._dock.name if self._dock else "",
            action_name=self._action,
            job_id=job_id,
            duration_s=round(took_s, 2),
            states=self._states,
            retries=max(self._retries, int(result.get("num_retries") or 0)),
            error=f"{in_words(code)}{f': {quoted(text)}' if text else ''}" if code else "",
            away_m=away[0],
            heading_off_deg=away[1],
            moved_m=moved,
            is_charging=battery.is_charging if battery else None,
            battery=battery.words if battery else "",
            helps=helps,
            note=" ".join(dict.fromkeys(filter(None, notes))),
        )

    async def _away(self, outcome: Outcome) -> tuple[float | None, float | None]:
        """Return the distance and the angle between the robot and the dock's pose."""
        if self._dock is None or self._dock.pose is None or outcome == "under way":
            return None, None
        await asyncio.sleep(_TRANSFORMS_S)
        where = await whereabouts(self._robot, self._dock.frame)
        if where.x_m is None or where.y_m is None or where.yaw_rad is None or where.trouble:
            return None, None
        x, y, yaw = self._dock.pose
        off = math.degrees(math.remainder(where.yaw_rad - yaw, 2 * math.pi))
        return round(math.hypot(where.x_m - x, where.y_m - y), 3), round(off, 1)

    async def _moved(self) -> float | None:
        before = self._before
        if before is None or before.x_m is None or before.y_m is None:
            return None
        await asyncio.sleep(_TRANSFORMS_S)
        after = await whereabouts(self._robot, "odom")
        if after.x_m is None or after.y_m is None or after.trouble:
            return None
        return round(math.hypot(after.x_m - before.x_m, after.y_m - before.y_m), 3)


class _Attempts(Kept):
    """The last attempts by their goals, for calls that wait on."""

    def __init__(self) -> None:
        self._by_goal: dict[str, _Attempt] = {}

    def keep(self, goal_id: str, attempt: _Attempt) -> None:
        self._by_goal[goal_id] = attempt
        while len(self._by_goal) > _MOST_KEPT:
            del self._by_goal[next(iter(self._by_goal))]

    def find(self, goal_id: str) -> _Attempt | None:
        return self._by_goal.get(goal_id)


def _doubt(battery: Battery | None) -> str:
    if battery is None:
        return "No battery is published: whether it charges is not verified."
    if battery.is_charging is None:
        return "Whether it charges is not known."
    return "" if battery.is_charging else "The battery does NOT charge."


def _dock_at(target: Target, kind: str) -> Dock:
    at = (target.x_m, target.y_m, target.yaw_rad or 0.0)
    return Dock(str(target), kind, target.frame, at)
