"""`ros2_send_action_goal`: send a goal, and wait for its result if asked to."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from time import monotonic
from typing import Any

from ros2_mcp.guard.policy import bounded
from ros2_mcp.model import names
from ros2_mcp.model.commands import Route, SendGoal
from ros2_mcp.model.errors import BridgeLost, LinkError, NotFound, RobotError, TimedOut, Unreachable
from ros2_mcp.model.goals import STATUS, goal_id_hex, new_goal_id
from ros2_mcp.ops.acting.defaults import left_at_default
from ros2_mcp.ops.acting.idle import why_idle, with_reason
from ros2_mcp.ops.acting.servers import check_one_server, servers_of_action
from ros2_mcp.ops.acting.servers import in_words as in_words_of
from ros2_mcp.ops.actions.cancel_when import ConditionalCancel, asked_for, begin
from ros2_mcp.ops.actions.result import STATUS_AFTER_S, result_of
from ros2_mcp.ops.actions.status import SERVER_S, states_now
from ros2_mcp.ops.log.complaints import complaints_from_now
from ros2_mcp.ops.results.results import SAID, Report, in_words, silent
from ros2_mcp.robot import Answer, Listening, Robot
from ros2_mcp.robot.goals import Goal
from ros2_mcp.robot.session import Session
from ros2_mcp_common.wire.limits import MAX_DURATION_S

ACCEPT_S = 10.0
"""A live server accepts or rejects a goal at once. If it takes longer than this, the call fails."""
_LAST_FEEDBACK_S = 0.02
"""Feedback and result take different paths: feedback that was sent before the result may arrive a little after it."""

_AGAIN_S = 0.2
"""Seconds between two attempts to follow a goal whose bridge was lost: the next bridge is there within a second."""
_REDISCOVERED_S = 10.0
"""Time for the next bridge to discover an action's server: discovery may take several seconds on a busy machine."""
_WENT_ON = "The bridge was lost meanwhile: the robot went on with the goal, and the next bridge saw it end."
_ANNOUNCED_S = 0.1
"""Time for an announcement. It takes milliseconds. A server that has had no goal yet has no latched message, so its
first goal is delayed by this.
"""


@dataclass(frozen=True, slots=True)
class GoalOutcome:
    """The outcome of sending a goal.

    `status` is `TIMEOUT` (code 0) if the wait timed out; the goal then continues. `result` is null until the goal has
    ended.
    """

    action_name: str = field(metadata=SAID)
    action_type: str
    accepted: bool
    goal_id: str = field(metadata=SAID)
    send_goal_stamp: dict[str, Any] | None
    waited: bool = False
    result_timeout_sec: float | None = None
    status_code: int = 1
    status: str = field(default=STATUS[1], metadata=SAID)
    result: dict[str, Any] | None = None
    feedback_count: int = 0
    last_feedback: dict[str, Any] | None = None
    note: str = ""

    @property
    def has_failed(self) -> bool:
        """Return whether the server rejected or aborted the goal. A goal that continues, or
        was cancelled, has not failed.
        """
        return not self.accepted or self.status == "ABORTED"

    def summary(self) -> str:
        """Return the result in one line."""
        return f"{self.action_name} goal {self.goal_id}: {self.status}. {self.note}".rstrip()


async def send_goal(
    robot: Robot,
    session: Session,
    action: str,
    action_type: str,
    goal: Mapping[str, Any],
    *,
    cancel_when: str = "",
    wait_for_result: bool = False,
    force: bool = False,
    timeout_s: float = 60.0,
    report: Report = silent,
    route: Route | None = None,
) -> GoalOutcome:
    """Send a goal, and wait for its result if asked to, reporting its feedback as progress.

    If the wait times out, the goal continues; if the wait is cancelled, the goal is cancelled. With `cancel_when` the
    bridge cancels the goal as soon as that condition holds (see `asked_for`), even if no call waits for the result. If
    several nodes serve the action, the goal is sent only with `force`. `route` is the list of goals to which it
    belongs.

    Raises:
        BadInput: if several nodes serve the action.
        NotFound: if there is no such action, or its server left.
        BadValue: if a value does not fit; it names the path, and nothing is sent.
        TimedOut: if the server neither accepted nor rejected the goal.
    """
    bounded("timeout_sec", timeout_s, 0.0, MAX_DURATION_S, "s")
    action = names.absolute(action, "action")
    action_type = await robot.types.action(action, action_type)
    servers = await servers_of_action(robot, action)
    if servers and not force:
        await check_one_server(robot, action, "End all but one, or set force=true.")
    several = f"{in_words_of(action, servers)}: each may carry it out." if servers else ""
    command = SendGoal(
        principal=session.principal,
        name=action,
        type=action_type,
        value=goal,
        goal_id=new_goal_id(),
        timeout_s=ACCEPT_S,
        wait_s=SERVER_S,
        route=route,
    )
    watch: ConditionalCancel | None = None
    if cancel_when.strip():
        asked = await asked_for(robot, action, action_type, command.goal_id, cancel_when)
        watch = await begin(robot, session.principal, asked)
    try:
        if not wait_for_result:
            return _with_note(await _submit(robot, session, command, goal), several)
        # Subscribed before anything else: the action server must have discovered this subscription when it accepts the
        # goal, or its first feedback is lost.
        async with robot.listen(
            f"{action}/_action/feedback", f"{action_type}_FeedbackMessage", wait_s=SERVER_S
        ) as listening:
            # A goal can overtake the announcement of that subscription, and its feedback is then not sent to us: all of
            # it, for 1 in 300 goals that publish at once, on a busy machine. A server takes in announcements in their
            # order: when a later subscription has its latched message, the server knows this one too.
            await states_now(robot, action, _ANNOUNCED_S)
            sent, deadline = _with_note(await _submit(robot, session, command, goal), several), monotonic() + timeout_s
            if not sent.accepted:
                return sent
            with suppress(BridgeLost, Unreachable):
                return await _ending(robot, sent, listening, timeout_s, report)
        return await _through_losses(robot, sent, deadline, timeout_s, report, was_lost=True)
    except asyncio.CancelledError:
        await asyncio.shield(_give_up(robot, command))
        raise
    finally:
        if watch and not ((sent := robot.jobs.get(Goal, command.goal_id)) and sent.is_running):
            await asyncio.shield(watch.stop())


def _with_note(sent: GoalOutcome, note: str) -> GoalOutcome:
    return replace(sent, note=f"{note} {sent.note}".strip()) if note else sent


Heard = Callable[[Mapping[str, Any]], None]
"""Called with each feedback of a goal, as JSON."""


async def follow(robot: Robot, goal: Goal, report: Report = silent, heard: Heard = lambda _: None) -> GoalOutcome:
    """Wait for the end of a goal that was sent, at most an hour, reporting its feedback as progress.

    Raises:
        NotFound: if its server left.
    """
    sent = GoalOutcome(goal.action, goal.action_type, True, goal.id, None)
    return await _through_losses(robot, sent, monotonic() + MAX_DURATION_S, MAX_DURATION_S, report, heard)


async def _through_losses(
    robot: Robot,
    sent: GoalOutcome,
    deadline: float,
    timeout_s: float,
    report: Report,
    heard: Heard = lambda _: None,
    *,
    was_lost: bool = False,
) -> GoalOutcome:
    """Wait for the end of a goal. If the bridge is lost, continue with its successor, as the
    robot continues with the goal.
    """
    topic, kind = f"{sent.action_name}/_action/feedback", f"{sent.action_type}_FeedbackMessage"
    while True:
        left_s = max(0.0, deadline - monotonic())
        try:
            async with robot.listen(topic, kind, wait_s=SERVER_S) as listening:
                ended = await _ending(robot, sent, listening, left_s, report, heard)
                return _with_note(replace(ended, result_timeout_sec=timeout_s), _WENT_ON if was_lost else "")
        except (BridgeLost, Unreachable) as error:
            if robot.graph.is_closed or not left_s or (isinstance(error, Unreachable) and error.is_lasting):
                raise
            was_lost = True
        except NotFound:  # the next bridge may not have discovered the server yet
            if not robot.graph.losses or robot.graph.bridge_age_s > _REDISCOVERED_S or not left_s:
                raise
        await asyncio.sleep(_AGAIN_S)


async def _submit(robot: Robot, session: Session, command: SendGoal, goal: Mapping[str, Any]) -> GoalOutcome:
    """Send the goal, and return when its server has accepted or rejected it."""
    await robot.values.learn(command.type)
    complaints = complaints_from_now(robot)
    calling = asyncio.ensure_future(robot.do(command, session))
    try:
        accepted, stamp = True, await _accepted_meanwhile(robot, command, calling)
        if stamp is None:
            response = await robot.fields_of(await calling)
            accepted, stamp = bool(response["accepted"]), response["stamp"]
        elif sent := robot.jobs.get(Goal, command.goal_id):
            sent.is_accepted = True
    except NotFound as error:
        gone = f"The server of {command.name} is not running, or left before it accepted the goal."
        raise NotFound(gone) from error
    except TimedOut as error:
        unanswered = TimedOut(
            f"The server of {command.name} did not accept or reject goal {command.goal_id} within {ACCEPT_S:g} s.",
            "It may still accept the goal; cancel it with ros2_cancel_action_goal.",
        )
        raise await with_reason(robot, unanswered, action=command.name) from error
    finally:
        calling.cancel()
    sent = GoalOutcome(command.name, command.type, accepted, command.goal_id, stamp if accepted else None)
    if not accepted:
        why = [await why_idle(robot, action=command.name), await complaints.said()]
        said = " ".join(filter(None, why)) or "ros2_log_read may show why."
        rejected = f"The action server rejected the goal. {said}"
        return replace(sent, status_code=-1, status=STATUS[-1], note=rejected)
    return replace(sent, note=left_at_default(robot.values.definitions, f"{command.type}_Goal", goal))


async def _accepted_meanwhile(
    robot: Robot, command: SendGoal, calling: asyncio.Future[Answer]
) -> dict[str, Any] | None:
    """Return the stamp of acceptance if the action's status has it before the answer arrives;
    None once the answer is there.

    A server that has not discovered its client yet drops its answer, and continues with the goal.
    """
    while not (await asyncio.wait({calling}, timeout=STATUS_AFTER_S))[0]:
        for state in await states_now(robot, command.name):
            if state.goal_id == command.goal_id and not calling.done():
                return state.accept_stamp
    return None


async def _ending(
    robot: Robot,
    sent: GoalOutcome,
    listening: Listening,
    timeout_s: float,
    report: Report,
    heard: Heard = lambda _: None,
) -> GoalOutcome:
    """Wait for the result of an accepted goal; meanwhile count its feedback, and report the newest."""
    count, last = 0, None

    async def take_feedback(first_within_s: float) -> bool:
        nonlocal count, last
        samples = await listening.take(first_within_s)
        for sample in samples:
            message = (await robot.values.render(listening.type, sample.data)).value
            if goal_id_hex(message["goal_id"]["uuid"]) == sent.goal_id:
                count, last = count + 1, message["feedback"]
                heard(message["feedback"])
        return bool(samples)

    async def follow() -> None:
        started = monotonic()
        while True:
            await take_feedback(1.0)
            await report(monotonic() - started, timeout_s, "no feedback yet" if last is None else in_words(last))

    following = asyncio.create_task(follow())
    try:
        ended = await result_of(robot, sent.action_name, sent.action_type, sent.goal_id, timeout_s)
    except (NotFound, LinkError) as error:
        raise type(error)(f"{error.message} Goal {sent.goal_id} had been accepted.", error.hint) from error
    finally:
        following.cancel()
    while await take_feedback(_LAST_FEEDBACK_S):
        pass
    why = await why_idle(robot, action=sent.action_name) if ended.status == "ABORTED" else ""
    return replace(
        sent,
        waited=True,
        result_timeout_sec=timeout_s,
        status_code=ended.status_code,
        status=ended.status,
        result=ended.result,
        feedback_count=count,
        last_feedback=last,
        note=" ".join(filter(None, (ended.note, sent.note, why))),
    )


async def _give_up(robot: Robot, command: SendGoal) -> None:
    """Cancel the goal, if it was sent and has not ended."""
    goal = robot.jobs.get(Goal, command.goal_id)
    if goal and goal.is_running:
        with suppress(RobotError):
            await goal.request_cancel(ACCEPT_S)
