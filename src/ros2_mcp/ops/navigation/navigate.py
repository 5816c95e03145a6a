"""`ros2_navigate`: send goals to Nav2, one after the other, as one job; a failed goal is explained."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from time import monotonic
from typing import Any

import anyio

from ros2_mcp.guard.policy import bounded
from ros2_mcp.model.commands import Route
from ros2_mcp.model.errors import LEASE, ApprovalNeeded, BadInput, NotFound, RobotError
from ros2_mcp.model.goals import STATUS, TERMINAL
from ros2_mcp.model.nav2 import NAVIGATE, NO_PROGRESS
from ros2_mcp.model.text import counted, named, quoted
from ros2_mcp.ops.acting.endings import ended_by, reason_of
from ros2_mcp.ops.actions.result import result_of
from ros2_mcp.ops.actions.running import running_goals
from ros2_mcp.ops.actions.send_goal import GoalOutcome, follow, send_goal
from ros2_mcp.ops.navigation.action_names import action_of
from ros2_mcp.ops.navigation.below import settle, why_lost
from ros2_mcp.ops.navigation.drive_watch import DriveWatch
from ros2_mcp.ops.navigation.explain import Explanation, Failure, explain
from ros2_mcp.ops.navigation.follow_drive import follow_drive
from ros2_mcp.ops.navigation.health import health_of
from ros2_mcp.ops.navigation.hold import MOST_PAUSED_S, Pausing
from ros2_mcp.ops.navigation.home import FirstStood, targets_in
from ros2_mcp.ops.navigation.last_pose import note_last_pose
from ros2_mcp.ops.navigation.navigated import Leg, LegState, Navigated, not_begun
from ros2_mcp.ops.navigation.planned_path import check_places, judge_path
from ros2_mcp.ops.navigation.route_plan import MOST_ROUTE_S, ONCE, RoutePlan, Visits, headed, key_of, pending_routes
from ros2_mcp.ops.navigation.targets import MAP_FRAME, Target
from ros2_mcp.ops.navigation.whereabouts import in_frame, whereabouts
from ros2_mcp.ops.results.results import Report, silent
from ros2_mcp.ops.space.plans import hear_plans
from ros2_mcp.robot import Robot
from ros2_mcp.robot.goals import UNKNOWN_GOAL, Goal
from ros2_mcp.robot.jobs import Job, abandon
from ros2_mcp.robot.session import Session
from ros2_mcp_common.wire.limits import MAX_DURATION_S

_ANSWERED_S = 1.0
"""A running server answers a request to cancel within milliseconds."""
_CANCELLED_S = 3.0
"""Time from the answer until the robot stands and the goal has ended."""
_ENDINGS = frozenset(STATUS[code] for code in TERMINAL)
_LOOK_S = 0.5
_SILENT_S = 1.5
"""Nav2's navigator sends feedback with each step of its tree, ten to a hundred times a second. After this silence the
server checks whether the navigator still runs."""
_ROLLS_S, _ROLLS_LOOK_S = 1.5, 0.05
"""The longest that a base rolls after its last command, and how often that is looked at."""
_GOES_ON_S = 15.0
"""The longest that a robot is waited for that moves on after its navigator has given up."""
_FAR_M = 0.35
"""Nav2's own tolerance is 0.25 m; a robot this far from the goal has not reached it, whatever Nav2 reports."""


class Navigation(Job):
    """Drives to goals of one action, one after the other, as often as its plan says.

    It ends with the first goal that is not reached, unless the plan goes on after a missed one. Nothing goes on after a
    stop, a cancelled goal, a lost navigator, or a goal of somebody else.
    """

    kind = "navigation"
    tool = "ros2_navigate"
    """The tool that waits for it."""
    most_running = 8
    """A robot has one Nav2, and a new goal of Nav2 replaces the goal before: more navigations than this make no sense.
    """

    def __init__(
        self,
        robot: Robot,
        session: Session,
        action: str,
        targets: Sequence[Target],
        stuck_s: float | None = None,
        plan: RoutePlan = ONCE,
    ) -> None:
        super().__init__(owner=session.principal, moves=[action])
        self.action = action
        self.plan = plan
        self.legs = [not_begun(target) for target in targets]
        self.visits = [Visits() for _ in targets]
        self.explanation: Explanation | None = None
        self.now, self.loop = 0, 1
        self._robot, self._session = robot, session
        self._targets = targets
        self._goal: Goal | None = None
        self.sent = set[str]()
        """Ids of the goals that it has sent."""
        self._leg_at = self._heard_at = monotonic()
        self.ending = ""
        """Text on the end of the goal if the navigator did not end it."""
        self.pausing = Pausing()
        self._lost = self._doing = self._unchecked = ""
        self._final: LegState | None = None
        self._stuck_s = math.inf if stuck_s is None else stuck_s
        self._is_stuck = self._is_missed = False
        self.watch = DriveWatch(began_at=monotonic())

    async def run(self) -> None:
        """Send each goal after the goal before it has been reached."""
        robot = self._robot
        robot.log.start()  # the log from now on helps to explain a failure
        where, _ = await asyncio.gather(whereabouts(robot, MAP_FRAME), hear_plans(robot))
        check_places(robot.policy, self._targets)
        robot.kept.get(FirstStood, FirstStood).note(where)
        start = (where.x_m, where.y_m) if where.x_m is not None and where.y_m is not None else None
        asked = key_of(self._session.principal, self.action, self._targets, self.plan)
        goals = pending_routes(robot).take(asked) or headed(self._targets, start, where.frame, self.plan.loops)
        try:
            await self._drive_all(goals)
        except ApprovalNeeded:
            pending_routes(robot).note(asked, goals)
            raise
        finally:
            if robot.guard.approvals:
                robot.guard.approvals.end_route(self.id)

    async def _drive_all(self, goals: Sequence[Target]) -> None:
        for loop in range(1, self.plan.loops + 1):
            self.loop = loop
            before = sum(visit.reached for visit in self.visits)
            for self.now, target in enumerate(goals):
                if not await self._visit(target, self._route(goals)):
                    return
            if sum(visit.reached for visit in self.visits) == before and self.loop < self.plan.loops:
                self.ending, self._final = "No place was reached in a whole loop.", "failed"
                return
        if any(visit.missed for visit in self.visits):
            self._final = "failed"

    def _route(self, goals: Sequence[Target]) -> Route:
        is_list = len(goals) > 1 or self.plan.loops > 1
        return self.plan.route(self.id, () if self.has_begun or not is_list else goals)

    async def _visit(self, target: Target, route: Route) -> bool:
        """Drive to a place, and wait there; return whether to go on with the next place."""
        if self.has_begun and (reason := await self._taken_over()):
            self.ending, self._final = reason, "canceled"
            return False
        self.legs[self.now] = not_begun(self._targets[self.now])
        try:
            while await self._drive_to(target, route):  # again after a pause
                route = self.plan.route(self.id)
            leg = self.legs[self.now]
            self._final = leg.outcome
            is_over = not (leg.outcome == "reached" or (self._is_missed and self.plan.goes_on))
            is_last = self.loop == self.plan.loops and self.now == len(self.legs) - 1
            self._count(leg)
            if is_over or is_last:
                return not is_over
            self._final = None
            return await self._stay(self.plan.wait_s(self.now) if leg.outcome == "reached" else 0.0)
        except asyncio.CancelledError:
            if self.legs[self.now].outcome in ("under way", "paused", "not begun"):
                with anyio.CancelScope(shield=True):
                    await self._give_up()
                self._final = self.legs[self.now].outcome
            raise
        except RobotError as error:
            if not self.has_begun:
                raise
            self._note(outcome="failed", note=str(error))
            self._final = "failed"
            self._count(self.legs[self.now])
            return False

    def _count(self, leg: Leg) -> None:
        """Count a visit, with the cause of a miss."""
        visit, why = self.visits[self.now], self.explanation
        if leg.outcome == "reached":
            visit.reached += 1
        elif leg.outcome != "canceled":
            visit.missed += 1
            visit.cause = why.cause if why else leg.note or self.ending
            visit.helps = " ".join(why.helps) if why else ""

    async def _taken_over(self) -> str:
        """Say why nothing more is begun: the latch was set, the link lease has lapsed, another goal runs, or the time
        is over. Return "" otherwise."""
        graph = self._robot.graph
        if graph.latched_at > self.started_at:
            return ended_by(reason_of(self._robot, "latch"))
        if graph.lapsed_at > self.started_at:
            return ended_by(LEASE)
        if self.elapsed_s > MOST_ROUTE_S:
            return f"It was ended after {MOST_ROUTE_S / 3600:g} h."
        return await self._replaced_by()

    async def _stay(self, wait_s: float) -> bool:
        """Wait at a place; time spent paused does not count. Return whether to go on."""
        until = monotonic() + wait_s
        while self.pausing.requested.is_set() or monotonic() < until:
            self._doing = f"Waiting here for {wait_s:g} s."
            with suppress(asyncio.TimeoutError):
                await asyncio.wait_for(self.pausing.requested.wait(), max(0.0, until - monotonic()))
            if self.pausing.requested.is_set():
                paused_at = monotonic()
                if not await self._hold():
                    return False
                until += monotonic() - paused_at
        return True

    async def _hold(self) -> bool:
        """Hold until the navigation is resumed; return whether it was."""
        self._doing = "Pausing: waiting until the robot stands."
        if await self.pausing.until_resumed(self._robot):
            self._doing = ""
            return True
        self.ending, self._final = f"It was ended: paused for more than {MOST_PAUSED_S / 60:g} min.", "canceled"
        return False

    async def _drive_to(self, target: Target, route: Route) -> bool:
        """Drive to a place; return True if the goal was paused, and is to be sent again."""
        robot = self._robot
        self._leg_at = monotonic()
        self._goal, self.explanation = None, None
        self._doing = self._lost = self.ending = ""
        self._is_stuck = self._is_missed = False
        self._unchecked = await judge_path(robot, self._session, self.action, target)
        sent = await send_goal(robot, self._session, self.action, NAVIGATE, {"pose": target.pose()}, route=route)
        self.sent.add(sent.goal_id)
        self._note(outcome="under way", goal_id=sent.goal_id)
        if not sent.accepted:
            self.begun()
            self._note(outcome="rejected")
            self.explanation = await explain(robot, self.action, target, Failure(True), monotonic() - self._leg_at)
            self._is_missed = True
            return False
        self._goal = robot.jobs.get(Goal, sent.goal_id)
        self.begun()
        if self._goal is None:
            raise NotFound(
                "This server no longer tracks that goal.",
                "ros2_action_status lists the goals that action servers still report.",
            )
        ended = await self._ended(self._goal)
        if self.watch.recoveries:
            self._note(recovered_by=self.watch.recoveries)
        if self._is_stuck:
            await self._end_stuck(target)
        elif ended and ended.status in _ENDINGS:
            await self._judge(target, ended)
        elif self.pausing.requested.is_set() and not self._lost:
            return await self._pause(target)
        else:
            await self._settle(target, self._lost or (ended.note if ended else ""))
        return False

    async def _pause(self, target: Target) -> bool:
        """Cancel the goal and hold; return True once the goal is to be sent again."""
        if problem := await self._ask_to_cancel():
            await self._settle(target, f"It could not be paused: {problem}")
            return False
        self._note(outcome="paused", remaining_m=None)
        if not await self._hold():
            self._note(outcome="canceled", note=self.ending)
            return False
        self.ending = await self._taken_over()
        if self.ending:
            self._note(outcome="canceled", note=self.ending)
            return False
        return True

    async def _ended(self, goal: Goal) -> GoalOutcome | None:
        """Return how a goal ended; None if its navigator was lost or the robot is stuck."""
        ended: GoalOutcome | None = None
        self._heard_at = monotonic()
        self.watch = DriveWatch(began_at=self._heard_at)
        async with anyio.create_task_group() as group:
            group.start_soon(self._watch_navigator, group.cancel_scope)
            group.start_soon(self._watch_pause, group.cancel_scope)
            group.start_soon(follow_drive, self._robot, self.action, self.watch)
            try:
                while ended is None or ended.status == "TIMEOUT":
                    ended = await follow(self._robot, goal, heard=self._hear)
            except RobotError as error:
                self._lost = error.message
            group.cancel_scope.cancel()
        return ended

    async def _watch_pause(self, following: anyio.CancelScope) -> None:
        """Stop following a goal that is to be paused."""
        await self.pausing.requested.wait()
        following.cancel()

    async def _watch_navigator(self, following: anyio.CancelScope) -> None:
        """Stop following a goal whose navigator sends no feedback and does not answer, or on which the robot is
        stuck."""
        graph = self._robot.graph
        while True:
            await asyncio.sleep(_LOOK_S)
            if self.watch.stuck_s(monotonic()) > self._stuck_s:
                self._is_stuck = True
                following.cancel()
                return
            if min(monotonic() - self._heard_at, graph.bridge_age_s) < _SILENT_S:
                continue
            before = self._heard_at
            why = await why_lost(self._robot, self.action)
            if why and self._heard_at == before:  # otherwise the navigator was only slow
                self._lost = why
                following.cancel()
                return
            self._heard_at = monotonic()  # the navigator is alive, but has no feedback

    async def _settle(self, target: Target, why: str) -> None:
        """After the navigator was lost: cancel the goals of the other servers and wait until the robot stands."""
        took_s = monotonic() - self._leg_at
        said = f"{why[0].upper()}{why[1:].rstrip('.')}." if why else "The end of the goal was not seen."
        self._note(remaining_m=None)
        self._doing = f"{said} Waiting until the robot stands."

        def tell(now: str) -> None:
            self._doing = f"{said} {now}"

        below, explanation, _ = await asyncio.gather(
            settle(self._robot, self._session, self.action, tell),
            explain(self._robot, self.action, target, Failure(False), took_s),
            self._ask_to_cancel(),
        )
        beside = () if explanation.cause.startswith("No cause") else (explanation.cause,)
        self.explanation = replace(
            explanation,
            cause=said,
            health=[*beside, *explanation.health],
            helps=['Start the navigator again: its process, or all of Nav2 with ros2_nav_recover(stack="up").'],
        )
        await self._measure(target)
        self._note(outcome="failed", duration_s=round(took_s, 2))
        self.ending = f"{said} {below.sentence}"
        self.doubt = "" if below.stands else self.ending

    async def _end_stuck(self, target: Target) -> None:
        """Cancel a goal on which the robot makes no progress, and explain why."""
        took_s, now = monotonic() - self._leg_at, monotonic()
        unmoved = self.watch.sees(now)
        seen = unmoved or "Nothing was seen that keeps it from it."
        told = f"Ended by stop_when_stuck_s: it has not come on for {self.watch.stuck_s(now):.0f} s. {seen}"
        self._doing = told
        if problem := await self._ask_to_cancel():
            await self._settle(target, f"{told} It could not be cancelled: {problem}")
            return
        self._note(remaining_m=None)
        failure = Failure(False, NO_PROGRESS, seen=unmoved)
        explanation = await explain(self._robot, self.action, target, failure, took_s)
        self.explanation = replace(explanation, server="", error_code=0, error="")  # the code is ours, not Nav2's
        self._is_missed = True
        await self._measure(target)
        self._note(outcome="failed", duration_s=round(took_s, 2))
        self.ending = told

    async def _ask_to_cancel(self) -> str:
        """Cancel the goal; return why that could not be confirmed, or ""."""
        goal = self._goal
        if goal is None or not goal.is_running:
            return ""
        server = f"the server of {named(self.action)}"
        try:
            with anyio.fail_after(_ANSWERED_S):
                response = await goal.request_cancel(_ANSWERED_S)
            if response["return_code"] == UNKNOWN_GOAL:
                return f"{server} does not know the goal"
            if not response["goals_canceling"] and goal.is_running:
                return f"{server} refuses it"
            ended = await result_of(self._robot, self.action, NAVIGATE, goal.id, _CANCELLED_S)
        except TimeoutError:
            return f"{server} has not answered within {_ANSWERED_S:g} s"
        except RobotError as error:
            return error.message
        return "" if ended.status in _ENDINGS else f"the goal has not ended within {_CANCELLED_S:g} s"

    async def _judge(self, target: Target, ended: GoalOutcome) -> None:
        """Record the outcome and the robot's pose by its transforms; explain a failure."""
        took_s = monotonic() - self._leg_at
        self._note(duration_s=round(took_s, 2))
        await self._measure(target)
        await note_last_pose(self._robot)
        if ended.status == "SUCCEEDED":
            away_m = self.legs[self.now].away_m
            far = away_m is not None and away_m > _FAR_M
            note = (
                f"Nav2 reports the goal reached, but by its transforms the robot is {away_m:.2f} m away." if far else ""
            )
            self._note(outcome="reached", remaining_m=None, note=note)
        elif ended.status == "CANCELED":
            reason = self.stop_reason or (self._goal.stop_reason if self._goal else "")
            self._note(outcome="canceled", note=ended.note or ended_by(reason or "a request to cancel it"))
        else:
            self._note(outcome="failed")
            result = ended.result or {}
            if not result.get("error_code") and (other := await self._replaced_by()):
                self._note(note=f"Another goal, from this or another client, replaced it. {other}")
                return
            if self.watch.is_moving:  # the navigator has given up, and a server below it goes on
                self._doing = "The goal failed, and the robot still moves: waiting until it stands."
                below = await settle(self._robot, self._session, self.action, lambda _: None, most_s=_GOES_ON_S)
                self.ending = f"The robot still moved after its navigator had given up. {below.sentence}"
                self.doubt = "" if below.stands else self.ending
                await self._measure(target)
            self._doing = "The goal failed; its cause is not found yet."
            failure = Failure(False, int(result.get("error_code", 0)), str(result.get("error_msg", "")))
            self.explanation = await explain(self._robot, self.action, target, failure, took_s)
            self._is_missed = True

    async def _measure(self, target: Target) -> None:
        """Record the distance and heading error to the goal once the robot stands: Nav2 ends a goal while it rolls."""
        until = monotonic() + _ROLLS_S
        while self.watch.is_moving and monotonic() < until:
            await asyncio.sleep(_ROLLS_LOOK_S)
        where = await whereabouts(self._robot, MAP_FRAME)
        goal = await in_frame(self._robot, target.frame, target.x_m, target.y_m, MAP_FRAME)
        if target.frame == where.base or not goal or where.x_m is None or where.y_m is None or where.trouble:
            return  # a goal in the robot's own frame moves with the robot
        off = None
        if self._targets[self.now].yaw_rad is not None and target.frame == MAP_FRAME and where.yaw_rad is not None:
            off = round(math.degrees(math.remainder(where.yaw_rad - (target.yaw_rad or 0.0), 2 * math.pi)), 1)
        self._note(away_m=round(math.hypot(goal[0] - where.x_m, goal[1] - where.y_m), 3), heading_off_deg=off)

    async def _replaced_by(self) -> str:
        """Say that another goal of the action is running, and how to end it; "" if there is none."""
        others = []
        with suppress(RobotError):
            others = await running_goals(self._robot, {self.action: [NAVIGATE]}, beside=self.sent)
        return " ".join(f"The robot drives on: {other.sentence}" for other in others)

    async def _give_up(self) -> None:
        """Cancel the running goal; if the navigator does not accept that, cancel the goals of the servers below it."""
        goal = self._goal
        if goal is None or not goal.is_running:
            self._note(outcome="canceled")
            return
        if not (problem := await self._ask_to_cancel()):
            self._note(outcome="canceled", note=await self._replaced_by())
            return
        below = await settle(self._robot, self._session, self.action, lambda _: None, most_s=0.0)
        self._note(outcome="failed", remaining_m=None)
        self.ending = f"It could not be cancelled: {problem.rstrip('.')}. {below.sentence}"
        self.doubt = self.ending

    def _hear(self, feedback: Mapping[str, Any]) -> None:
        """Take the feedback of Nav2."""
        self._heard_at = monotonic()
        remaining, recoveries = feedback.get("distance_remaining"), feedback.get("number_of_recoveries")
        if isinstance(remaining, (int, float)) and math.isfinite(remaining):
            self.watch.remaining(remaining, monotonic())
            self._note(remaining_m=round(remaining, 2))
        if isinstance(recoveries, int):
            self._note(recoveries=recoveries)

    def _note(self, **changed: Any) -> None:
        self.legs[self.now] = replace(self.legs[self.now], **changed)

    def line(self) -> str:
        """Return one line on the progress."""
        leg = self.legs[self.now]
        to = quoted(leg.place) if leg.place else f"({leg.x_m:.2f}, {leg.y_m:.2f})"
        which = f" ({self.now + 1} of {len(self.legs)})" if len(self.legs) > 1 else ""
        which += f" in loop {self.loop} of {self.plan.loops}" if self.plan.loops > 1 else ""
        if self.pausing.hold:
            return f"to {to}{which}: paused. {self.pausing.hold.sentence}"
        if self._doing:
            return f"to {to}{which}: {monotonic() - self._leg_at:.0f} s: {self._doing}"
        left = "" if leg.remaining_m is None else f", {leg.remaining_m:.1f} m to go"
        by = f" ({self.watch.recoveries})" if self.watch.recoveries else ""
        freed = f", {counted(leg.recoveries, 'recovery', 'recoveries')}{by}" if leg.recoveries else ""
        seen = self.watch.sees(monotonic())
        return f"to {to}{which}: {monotonic() - self._leg_at:.0f} s{left}{freed}{f'. {seen}' if seen else ''}"

    def so_far(self) -> Navigated:
        """Return the result as it is known now."""
        last = self.legs[self.now]
        outcome: LegState = self._final or "canceled"
        if self.is_running:
            outcome = "paused" if self.pausing.hold else "under way"
        note = ""
        if self.pausing.hold:
            note = f"{self.pausing.hold.sentence} ros2_nav_pause(resume=true) resumes it; ros2_stop ends it."
        elif outcome == "under way":
            note = f'The robot is still under way: wait with {self.tool}(job_id="{self.id}"); ros2_stop ends it.'
            if self.legs[self.now].outcome == "failed":
                note = f'Ask for it with {self.tool}(job_id="{self.id}").'
            note = f"{self._doing} {note}".lstrip()
        elif outcome == "canceled" and self.stop_reason:
            note = ended_by(self.stop_reason)
        else:
            note = self.ending
        legs = list(self.legs)
        if self.is_running and last.outcome == "under way":
            took_s = round(monotonic() - self._leg_at, 2)
            legs[self.now] = replace(last, duration_s=took_s, recovered_by=self.watch.recoveries)
        return Navigated(
            outcome=outcome,
            action_name=self.action,
            job_id=self.id,
            duration_s=round(self.elapsed_s, 2),
            legs=legs,
            explanation=self.explanation,
            note=f"{note} {self._unchecked}".strip(),
        )


async def navigate(
    robot: Robot,
    session: Session,
    to: object,
    *,
    action: str = "",
    job_id: str = "",
    timeout_s: float = 45.0,
    stuck_s: float | None = None,
    report: Report = silent,
) -> Navigated:
    """Drive to places, or wait for a running navigation; wait at most `timeout_s`, after which the navigation
    continues.

    Cancelling this call cancels the goal. With `stuck_s`, the navigation ends if the robot makes no progress for that
    long.

    Raises:
        BadInput: for a malformed place, or neither a place nor a job.
        NotFound: for an unknown place or job, or without Nav2.
        RobotError: what sending the first goal raises; nothing was sent then, unless the error says so.
    """
    bounded("timeout_s", timeout_s, 0.0, MAX_DURATION_S, "s")
    if job_id or to is None:
        job = known_job(robot, to, job_id)
    else:
        targets = targets_in(robot, to)
        job = Navigation(robot, session, await action_of(robot, NAVIGATE, action), targets, stuck_s)
        await robot.jobs.start(job)
    health = await wait_for(robot, job, timeout_s, report)
    return replace(job.so_far(), health=health)


def known_job(robot: Robot, to: object, job_id: str) -> Navigation:
    """Return the navigation with this id.

    Raises:
        BadInput: if places are given as well, or no id.
        NotFound: for an unknown id.
    """
    if not job_id:
        raise BadInput("`to` is missing: it says where to go.", "Give a place, a pose, or a list of them.")
    if to is not None:
        raise BadInput("job_id waits for a navigation under way: it takes no new place.", "Give one of the two.")
    return robot.jobs.find(Navigation, job_id)


async def wait_for(robot: Robot, job: Navigation, timeout_s: float, report: Report) -> Sequence[str]:
    """Wait until a navigation has ended or is paused, at most `timeout_s`; return sentences on how it goes if it is
    still under way. Cancelling this ends the navigation.

    Raises:
        RobotError: if the first goal could not be sent.
    """

    async def progress() -> None:
        await report(min(job.elapsed_s, timeout_s), timeout_s, job.line())

    await robot.jobs.wait(job, timeout_s, every_second=progress, until=lambda: job.pausing.hold is not None)
    if job.failure and not job.has_begun:
        raise job.failure
    if not job.is_running:
        return ()
    try:
        health = await health_of(robot, job.action)
    except asyncio.CancelledError:  # as while waiting: a caller who cancels wants the robot to stand
        await abandon(job)
        raise
    if not job.is_running:
        return ()
    seen = job.watch.sees(monotonic()) if not job.pausing.hold else ""
    return [*([seen] if seen else []), *health]
