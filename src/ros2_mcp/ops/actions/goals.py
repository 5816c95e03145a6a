"""Goals: sending and cancelling them, and waiting for their results."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from time import monotonic
from typing import Any

from ros2_mcp.guard.policy import bounded
from ros2_mcp.model import names
from ros2_mcp.model.commands import CancelGoals, SendGoal
from ros2_mcp.model.errors import BadValue, LinkError, NotFound, RobotError, TimedOut
from ros2_mcp.model.goals import (
    CANCEL_CODES,
    STATUS,
    TERMINAL,
    goal_id_bytes,
    goal_id_hex,
    new_goal_id,
)
from ros2_mcp.model.samples import Sample
from ros2_mcp.ops.actions.list import SERVER_S, states_now
from ros2_mcp.ops.results import Report, in_words, reporting, silent
from ros2_mcp.robot import Answer, Listening, Robot
from ros2_mcp.robot.sent_goals import Goal
from ros2_mcp_bridge.limits import MAX_DURATION_S

ACCEPT_S = 10.0
"""A server that is alive says at once whether it takes a goal; of one that thinks longer the caller is told."""
ENDED_ALREADY = 3
UNKNOWN_GOAL = 2
"""These two are codes of action_msgs/srv/CancelGoal (`CANCEL_CODES`)."""
_STATUS_AFTER_S = 1.0
"""Answers come within milliseconds; after this the action's status is looked at, in case the answer was lost."""
_STATUS_EVERY_S = 3.0
"""Looking costs a subscription each time; a result whose answer was lost comes that much later."""
_AT_LEAST_S = 0.1
"""A service call needs some time even if none is left, so that a result that is there comes."""
_LAST_FEEDBACK_S = 0.02
"""Feedback and result come on different ways: what was sent before the result may arrive a little after it."""
_AGAIN_S = 0.1
"""Between requests to cancel a goal that its server has yet to accept."""


@dataclass(frozen=True, slots=True)
class GoalOutcome:
    """What became of a goal.

    `status` is `TIMEOUT` (code 0) if the waiting ended first; the goal then goes on. `result` is null until it ended.
    """

    action_name: str
    action_type: str
    accepted: bool
    goal_id: str
    send_goal_stamp: dict[str, Any] | None
    waited: bool
    result_timeout_sec: float | None
    status_code: int
    status: str
    result: dict[str, Any] | None
    feedback_count: int
    last_feedback: dict[str, Any] | None
    note: str

    def summary(self) -> str:
        """One line."""
        return f"{self.action_name} goal {self.goal_id}: {self.status}. {self.note}".rstrip()


@dataclass(frozen=True, slots=True)
class GoalResult:
    """The result of a goal, whoever sent it; `TIMEOUT` (code 0) if it had not ended in time."""

    service: str
    goal_id: str
    waited: bool
    result_timeout_sec: float | None
    status_code: int
    status: str
    result: dict[str, Any] | None
    note: str

    def summary(self) -> str:
        """One line."""
        return f"goal {self.goal_id}: {self.status}. {self.note}".rstrip()


async def send_goal(
    robot: Robot,
    action: str,
    action_type: str,
    goal: Mapping[str, Any],
    *,
    wait_for_result: bool = False,
    timeout_s: float = 60.0,
    report: Report = silent,
) -> GoalOutcome:
    """Sends a goal, and waits for its result if asked to, reporting its feedback as progress.

    A waiting that times out leaves the goal running; a waiting that is cancelled cancels the goal.

    Raises:
        NotFound: if no such action is there, or its server left.
        BadValue: naming the path of a value that does not fit; nothing is sent.
        TimedOut: if the server did not say whether it accepts.
    """
    bounded("timeout_sec", timeout_s, 0.0, MAX_DURATION_S, "s")
    action = names.absolute(action, "action")
    action_type = await robot.types.action(action, action_type)
    goal_id = new_goal_id()
    sent = _Goal(robot, action, action_type, goal_id)
    try:
        if wait_for_result:
            return await sent.send_and_wait(goal, timeout_s, report)
        return sent.outcome(*await sent.submit(goal))
    except asyncio.CancelledError:
        await asyncio.shield(sent.give_up())
        raise


class _Goal:
    """One goal of ours on its way."""

    def __init__(self, robot: Robot, action: str, action_type: str, goal_id: str) -> None:
        self._robot, self._action, self._type, self._id = robot, action, action_type, goal_id
        self._left_out = ""

    async def send_and_wait(self, goal: Mapping[str, Any], timeout_s: float, report: Report) -> GoalOutcome:
        topic, kind = f"{self._action}/_action/feedback", f"{self._type}_FeedbackMessage"
        async with self._robot.listen(topic, kind, wait_s=SERVER_S) as heard:
            accepted, stamp = await self.submit(goal)
            if not accepted:
                return self.outcome(accepted, stamp)
            feedback = _Feedback(self._robot, heard, self._id, timeout_s, report)
            try:
                ended = await self._ending(feedback, timeout_s)
            except (NotFound, LinkError) as error:
                raise type(error)(f"{error.message} Goal {self._id} had been accepted.", error.hint) from error
        return self.outcome(
            True,
            stamp,
            waited=True,
            result_timeout_sec=timeout_s,
            status_code=ended.status_code,
            status=ended.status,
            result=ended.result,
            feedback_count=feedback.count,
            last_feedback=feedback.last,
            note=f"{self._left_out} {ended.note}".strip(),
        )

    async def submit(self, goal: Mapping[str, Any]) -> tuple[bool, dict[str, Any]]:
        """Whether the server accepts the goal, and when it did."""
        robot = self._robot
        await robot.values.learn(self._type)
        missing = robot.values.missing_fields(f"{self._type}_Goal", goal)
        self._left_out = f"Sent with their default values: {', '.join(missing)}." if missing else ""
        command = SendGoal(
            principal=robot.principal,
            name=self._action,
            type=self._type,
            value=goal,
            goal_id=self._id,
            timeout_s=ACCEPT_S,
            wait_s=SERVER_S,
        )
        calling = asyncio.ensure_future(robot.do(command))
        try:
            told = await self._told_before(calling)
            if told is not None:
                if sent := robot.jobs.get(Goal, self._id):
                    sent.is_accepted = True
                return True, told
            answer = await calling
        except NotFound as error:
            gone = f"The server of {self._action} is not there, or left before it said that it accepts the goal."
            raise NotFound(gone) from error
        except TimedOut as error:
            raise TimedOut(
                f"The server of {self._action} did not say within {ACCEPT_S:g} s whether it accepts goal {self._id}.",
                "It may still accept it: ros2_cancel_action_goal cancels it.",
            ) from error
        finally:
            calling.cancel()
        response = robot.fields_of(answer)
        return bool(response["accepted"]), response["stamp"]

    async def _told_before(self, calling: asyncio.Future[Answer]) -> dict[str, Any] | None:
        """When the goal was accepted, if the status of the action tells so while the answer keeps us waiting.

        A server that has not discovered its client yet throws its answer away, and goes on with the goal.
        """
        while not (await asyncio.wait({calling}, timeout=_STATUS_AFTER_S))[0]:
            for state in await states_now(self._robot, self._action):
                if state.goal_id == self._id and not calling.done():
                    return state.accept_stamp
        return None

    async def give_up(self) -> None:
        """Cancels the goal, if it was sent and has not ended."""
        goal = self._robot.jobs.get(Goal, self._id)
        if goal and goal.is_running:
            with suppress(RobotError):
                await cancel_sent(self._robot, self._action, self._id, ACCEPT_S)

    def outcome(self, accepted: bool, stamp: dict[str, Any], **known: Any) -> GoalOutcome:
        """What became of it; `known` are the fields beyond those of a goal that is not waited for."""
        code = 1 if accepted else -1
        defaults: dict[str, Any] = {
            "waited": False,
            "result_timeout_sec": None,
            "status_code": code,
            "status": STATUS[code],
            "result": None,
            "feedback_count": 0,
            "last_feedback": None,
            "note": self._left_out if accepted else "The action server rejected the goal; ros2_log_read may tell why.",
        }
        since = stamp if accepted else None
        return GoalOutcome(self._action, self._type, accepted, self._id, since, **{**defaults, **known})

    async def _ending(self, feedback: _Feedback, timeout_s: float) -> GoalResult:
        following = asyncio.create_task(feedback.follow())
        try:
            return await _result(self._robot, self._action, self._type, self._id, timeout_s, SERVER_S)
        finally:
            following.cancel()
            await feedback.drain()


class _Feedback:
    """Follows the feedback of one goal while its result is waited for."""

    def __init__(self, robot: Robot, heard: Listening, goal_id: str, timeout_s: float, report: Report) -> None:
        self.count = 0
        self.last: dict[str, Any] | None = None
        self._robot, self._heard, self._goal_id = robot, heard, goal_id
        self._timeout_s, self._report = timeout_s, report

    async def follow(self) -> None:
        """Takes feedback until cancelled, reporting the newest at least once a second."""
        started = monotonic()
        while True:
            self._take(await self._heard.take(1.0))
            line = "no feedback yet" if self.last is None else in_words(self.last)
            await self._report(monotonic() - started, self._timeout_s, line)

    async def drain(self) -> None:
        """Takes what came together with the result."""
        while samples := await self._heard.take(_LAST_FEEDBACK_S):
            self._take(samples)

    def _take(self, samples: Sequence[Sample]) -> None:
        for sample in samples:
            message = self._robot.values.render(self._heard.type, sample.data).value
            if goal_id_hex(message["goal_id"]["uuid"]) == self._goal_id:
                self.count += 1
                self.last = message["feedback"]


async def request_result(
    robot: Robot,
    action: str,
    action_type: str,
    goal_id: str,
    *,
    timeout_s: float | None = 60.0,
    wait_for_service_s: float = SERVER_S,
    report: Report = silent,
) -> GoalResult:
    """Waits for the result of a goal, whoever sent it. A time-out does not cancel it.

    Raises:
        NotFound: if no such action is there, or its server left while it was waited for.
        BadValue: if the goal id is not one.
    """
    action = names.absolute(action, "action")
    wait_s = MAX_DURATION_S if timeout_s is None else bounded("timeout_sec", timeout_s, 0.0, MAX_DURATION_S, "s")
    goal_id = goal_id_hex(goal_id_bytes(goal_id))
    if action_type and action not in await robot.types.actions():
        action_type = names.interface_type(action_type, "action")  # its server may still have to appear
    else:
        action_type = await robot.types.action(action, action_type)
    async with reporting(report, wait_s, f"waiting for the result of {action}"):
        return await _result(robot, action, action_type, goal_id, timeout_s, wait_for_service_s)


async def _result(
    robot: Robot, action: str, action_type: str, goal_id: str, timeout_s: float | None, wait_for_service_s: float
) -> GoalResult:
    service, service_type = f"{action}/_action/get_result", f"{action_type}_GetResult"
    wait_s = MAX_DURATION_S if timeout_s is None else timeout_s
    deadline = monotonic() + wait_s

    def ask() -> asyncio.Future[Answer]:
        request = {"goal_id": {"uuid": goal_id_bytes(goal_id)}}
        left_s = max(deadline - monotonic(), _AT_LEAST_S)
        return asyncio.ensure_future(
            robot.ask_service(service, service_type, request, timeout_s=left_s, wait_s=wait_for_service_s)
        )

    asking = ask()
    try:
        while await _is_lost(robot, action, goal_id, asking):
            asking.cancel()
            asking = ask()
        answer = await asking
    except NotFound as error:
        raise NotFound(f"The server of {action} is not there, or left before the goal ended.") from error
    except TimedOut:
        note = f"No result within {wait_s:g} s. The goal was not cancelled: ask again with this goal id."
        return GoalResult(service, goal_id, True, timeout_s, 0, "TIMEOUT", None, note)
    finally:
        asking.cancel()
    response = robot.values.render(answer.type, answer.body).value
    code = int(response["status"])
    if code in TERMINAL or code == 0:
        robot.goal_ended(goal_id)
    note = "The server does not know this goal: it never was, or it has been forgotten." if code == 0 else ""
    result = response["result"] if code in TERMINAL else None
    return GoalResult(service, goal_id, True, timeout_s, code, STATUS.get(code, str(code)), result, note)


async def _is_lost(robot: Robot, action: str, goal_id: str, asking: asyncio.Future[Answer]) -> bool:
    """Waits for the answer; true where it stays away although the action's status tells that the goal has ended."""
    while not (await asyncio.wait({asking}, timeout=_STATUS_EVERY_S))[0]:
        ended = {state.goal_id for state in await states_now(robot, action) if state.status_code in TERMINAL}
        if goal_id in ended:
            return not (await asyncio.wait({asking}, timeout=_STATUS_AFTER_S))[0]
    return False


@dataclass(frozen=True, slots=True)
class CancelledGoal:
    """A goal that the server is cancelling."""

    goal_id: str
    stamp: dict[str, Any]


@dataclass(frozen=True, slots=True)
class Cancellation:
    """The server's answer to a cancel request."""

    service: str
    return_code: int
    return_code_text: str
    goals_canceling: Sequence[CancelledGoal]
    note: str

    def summary(self) -> str:
        """One line."""
        refused = f"{self.return_code_text}: " if self.return_code else ""
        return f"{refused}{len(self.goals_canceling)} goal(s) are being cancelled. {self.note}".rstrip()


async def cancel(
    robot: Robot,
    action: str,
    goal_id: str = "",
    *,
    cancel_all: bool = False,
    stamp: Mapping[str, int] | None = None,
    timeout_s: float = 3.0,
) -> Cancellation:
    """Asks the server to cancel one goal, all goals, or all that were accepted up to a stamp.

    Raises:
        BadValue: if there is neither a goal id nor `cancel_all`.
        NotFound: if no such action is there.
        TimedOut: if the server did not answer.
    """
    action = names.absolute(action, "action")
    if not goal_id and not cancel_all:
        raise BadValue("goal_id_hex", "no goal is named.", "Give its id, or set cancel_all to cancel every goal.")
    goal_id = "" if cancel_all else goal_id_hex(goal_id_bytes(goal_id))
    await robot.types.action(action)
    command = CancelGoals(principal=robot.principal, name=action, goal_id=goal_id, stamp=stamp, timeout_s=timeout_s)
    response = robot.fields_of(await robot.do(command))
    code = int(response["return_code"])
    goals = [CancelledGoal(goal_id_hex(goal["goal_id"]["uuid"]), goal["stamp"]) for goal in response["goals_canceling"]]
    return Cancellation(command.service, code, CANCEL_CODES.get(code, str(code)), goals, _note(code, goals, cancel_all))


async def cancel_sent(robot: Robot, action: str, goal_id: str, within_s: float) -> Cancellation:
    """Cancels a goal of ours; asks again, for so long, while its server has yet to accept it and so does not know it.

    Raises:
        NotFound: if no such action is there.
        TimedOut: if the server did not answer.
    """
    deadline = monotonic() + within_s
    while True:
        goal = robot.jobs.get(Goal, goal_id)
        is_on_its_way = bool(goal and goal.is_running and not goal.is_accepted)
        answer = await cancel(robot, action, goal_id)
        if answer.return_code != UNKNOWN_GOAL or not is_on_its_way or monotonic() > deadline:
            return answer
        await asyncio.sleep(_AGAIN_S)


def _note(code: int, goals: Sequence[CancelledGoal], cancel_all: bool) -> str:
    if code == 0 and goals:
        return "A goal ends when the server has stopped it: ros2_action_request_result tells."
    notes: Mapping[int, str] = {
        0: "Nothing was running, or the server refuses." if cancel_all else "The server refuses to cancel this goal.",
        1: "The server refuses to cancel.",
        UNKNOWN_GOAL: "The server does not know such a goal.",
        ENDED_ALREADY: "The goal had ended already.",
    }
    return notes.get(code, "")
