"""Actions, made of what they are on the wire: three services and two topics under `<name>/_action/`."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from time import monotonic
from typing import Any

from ros2_mcp.guard.policy import bounded
from ros2_mcp.model import names
from ros2_mcp.model.errors import NotFound, RobotError, TimedOut, TypeConflict, UnknownInterface
from ros2_mcp.model.goals import (
    CANCEL_CODES,
    CANCEL_TYPE,
    STATUS,
    TERMINAL,
    cancel_request,
    goal_id_bytes,
    goal_id_hex,
    new_goal_id,
)
from ros2_mcp.ops.results import Report, silent
from ros2_mcp.robot import Listening, Robot

MAX_WAIT_S = 3600.0
SERVER_S = 3.0


@dataclass(frozen=True, slots=True)
class ActionEntry:
    """One action; `request_fields` is name → type of its goal."""

    name: str
    types: Sequence[str]
    request_fields: dict[str, Any]


@dataclass(frozen=True, slots=True)
class ActionList:
    """The actions that have a server."""

    actions: Sequence[ActionEntry]

    def summary(self) -> str:
        """One line."""
        return f"{len(self.actions)} action(s)."


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
        return f"{self.return_code_text}: {len(self.goals_canceling)} goal(s) are being cancelled. {self.note}".rstrip()


async def action_types(robot: Robot) -> dict[str, list[str]]:
    """Action → its types, of every action with a server or a client in the graph."""
    services = (await robot.graph.query("services"))["services"]
    ending = "/_action/send_goal"
    return {
        name.removesuffix(ending): [kind.removesuffix("_SendGoal") for kind in types]
        for name, types in services
        if name.endswith(ending)
    }


async def list_actions(robot: Robot, pattern: str = "") -> ActionList:
    """The actions with their types and the fields of their goals."""
    known = await action_types(robot)
    chosen = names.matching(sorted(known), pattern)
    return ActionList([ActionEntry(name, known[name], await _goal_fields(robot, known[name][0])) for name in chosen])


async def resolve_type(robot: Robot, action: str, asked: str = "") -> str:
    """The type of an action: the asked one, or the one that the graph knows.

    Raises:
        NotFound: if no such action is there.
        TypeConflict: if it has another type than the asked one, or several and none is asked for.
    """
    known = await action_types(robot)
    types = known.get(action, [])
    wanted = names.interface_type(asked, "action") if asked else ""
    if not types:
        hint = names.did_you_mean(action, list(known), "ros2_list_actions shows what is there.")
        raise NotFound(f"There is no action {action}: no server offers it.", hint)
    if wanted and wanted not in types:
        raise TypeConflict(f"{action} has the type {' and '.join(types)}, not {wanted}.", "Leave the type out.")
    if not wanted and len(types) > 1:
        raise TypeConflict(f"{action} has {len(types)} types: {', '.join(types)}.", "Give the type you mean.")
    return wanted or types[0]


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
    bounded("timeout_sec", timeout_s, 0.0, MAX_WAIT_S, "s")
    action = names.absolute(action, "action")
    action_type = await resolve_type(robot, action, action_type)
    goal_id = new_goal_id()
    if not wait_for_result:
        accepted, stamp = await _submit(robot, action, action_type, goal_id, goal)
        return _outcome(action, action_type, goal_id, accepted, stamp)
    async with robot.listen(f"{action}/_action/feedback", f"{action_type}_FeedbackMessage", wait_s=SERVER_S) as heard:
        accepted, stamp = await _submit(robot, action, action_type, goal_id, goal)
        if not accepted:
            return _outcome(action, action_type, goal_id, accepted, stamp)
        return await _await_result(robot, action, action_type, goal_id, stamp, heard, timeout_s, report)


async def _submit(
    robot: Robot, action: str, action_type: str, goal_id: str, goal: Mapping[str, Any]
) -> tuple[bool, dict[str, Any]]:
    service = f"{action_type}_SendGoal"
    request = {"goal_id": {"uuid": goal_id_bytes(goal_id)}, "goal": dict(goal)}
    await robot.values.encode(f"{service}_Request", request)
    await robot.values.learn(CANCEL_TYPE)
    robot.goal_sent(goal_id, action, action_type)
    answer = await robot.call(f"{action}/_action/send_goal", service, request, timeout_s=10.0, wait_s=SERVER_S)
    response = robot.values.render(f"{service}_Response", answer.body).value
    if not response["accepted"]:
        robot.goal_ended(goal_id)
    return bool(response["accepted"]), response["stamp"]


def _outcome(
    action: str, action_type: str, goal_id: str, accepted: bool, stamp: dict[str, Any], **known: Any
) -> GoalOutcome:
    code = 1 if accepted else -1
    defaults: dict[str, Any] = {
        "waited": False,
        "result_timeout_sec": None,
        "status_code": code,
        "status": STATUS[code],
        "result": None,
        "feedback_count": 0,
        "last_feedback": None,
        "note": "" if accepted else "The action server rejected the goal.",
    }
    return GoalOutcome(action, action_type, accepted, goal_id, stamp if accepted else None, **{**defaults, **known})


async def _await_result(
    robot: Robot,
    action: str,
    action_type: str,
    goal_id: str,
    stamp: dict[str, Any],
    heard: Listening,
    timeout_s: float,
    report: Report,
) -> GoalOutcome:
    feedback = _Feedback(robot, heard, goal_id, timeout_s, report)
    following = asyncio.create_task(feedback.follow())
    try:
        ended = await request_result(robot, action, action_type, goal_id, timeout_s=timeout_s)
    except asyncio.CancelledError:
        await asyncio.shield(_give_up(robot, action, goal_id))
        raise
    finally:
        following.cancel()
    return _outcome(
        action,
        action_type,
        goal_id,
        True,
        stamp,
        waited=True,
        result_timeout_sec=timeout_s,
        status_code=ended.status_code,
        status=ended.status,
        result=ended.result,
        feedback_count=feedback.count,
        last_feedback=feedback.last,
        note=ended.note,
    )


async def _give_up(robot: Robot, action: str, goal_id: str) -> None:
    with suppress(RobotError):
        await cancel(robot, action, goal_id)


class _Feedback:
    """Follows the feedback of one goal while its result is waited for."""

    def __init__(self, robot: Robot, heard: Listening, goal_id: str, timeout_s: float, report: Report) -> None:
        self.count = 0
        self.last: dict[str, Any] | None = None
        self._robot, self._heard, self._goal_id = robot, heard, goal_id
        self._timeout_s, self._report = timeout_s, report

    async def follow(self) -> None:
        """Takes feedback until cancelled, reporting the newest."""
        started = monotonic()
        while True:
            for sample in await self._heard.take(1.0):
                message = self._robot.values.render(self._heard.type, sample.data).value
                if goal_id_hex(message["goal_id"]["uuid"]) == self._goal_id:
                    self.count += 1
                    self.last = message["feedback"]
            if self.last is not None:
                await self._report(monotonic() - started, self._timeout_s, _line(self.last))


def _line(feedback: Mapping[str, Any]) -> str:
    """Feedback as a readable line of its plain values."""
    plain = {name: value for name, value in feedback.items() if isinstance(value, (int, float, str))}
    return ", ".join(
        f"{name} {value:.3g}" if isinstance(value, float) else f"{name} {value}" for name, value in plain.items()
    )


async def request_result(
    robot: Robot,
    action: str,
    action_type: str,
    goal_id: str,
    *,
    timeout_s: float | None = 60.0,
    wait_for_service_s: float = SERVER_S,
) -> GoalResult:
    """Waits for the result of a goal, whoever sent it. A time-out does not cancel it.

    Raises:
        NotFound: if no such action is there, or its server left while it was waited for.
        BadValue: if the goal id is not one.
    """
    action = names.absolute(action, "action")
    wait_s = MAX_WAIT_S if timeout_s is None else bounded("timeout_sec", timeout_s, 0.0, MAX_WAIT_S, "s")
    raw_id = goal_id_bytes(goal_id)
    action_type = await resolve_type(robot, action, action_type)
    service, service_type = f"{action}/_action/get_result", f"{action_type}_GetResult"
    try:
        answer = await robot.inquire(
            service, service_type, {"goal_id": {"uuid": raw_id}}, timeout_s=wait_s, wait_s=wait_for_service_s
        )
    except TimedOut:
        note = f"No result within {wait_s:g} s. The goal was not cancelled: ask again with this goal id."
        return GoalResult(service, goal_id, True, timeout_s, 0, "TIMEOUT", None, note)
    response = robot.values.render(f"{service_type}_Response", answer.body).value
    code = int(response["status"])
    if code in TERMINAL:
        robot.goal_ended(goal_id)
    note = "The server does not know this goal: it never was, or it has been forgotten." if code == 0 else ""
    result = response["result"] if code in TERMINAL else None
    return GoalResult(service, goal_id, True, timeout_s, code, STATUS.get(code, str(code)), result, note)


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
    await resolve_type(robot, action)
    goal_id_bytes("0" * 32 if cancel_all else goal_id)
    request = cancel_request("" if cancel_all else goal_id, stamp)
    service = f"{action}/_action/cancel_goal"
    answer = await robot.call(service, CANCEL_TYPE, request, timeout_s=timeout_s, wait_s=timeout_s)
    response = robot.values.render(f"{CANCEL_TYPE}_Response", answer.body).value
    code = int(response["return_code"])
    goals = [CancelledGoal(goal_id_hex(goal["goal_id"]["uuid"]), goal["stamp"]) for goal in response["goals_canceling"]]
    return Cancellation(service, code, CANCEL_CODES.get(code, str(code)), goals, _cancel_note(code, goals))


def _cancel_note(code: int, goals: Sequence[CancelledGoal]) -> str:
    if code == 0 and goals:
        return "The goal ends when the server has stopped it: ros2_action_request_result tells."
    notes: Mapping[int, str] = {
        0: "There was nothing to cancel.",
        1: "The server refuses to cancel.",
        2: "The server does not know such a goal.",
        3: "The goal had ended already.",
    }
    return notes.get(code, "")


async def _goal_fields(robot: Robot, action_type: str) -> dict[str, Any]:
    try:
        await robot.values.learn(action_type)
    except UnknownInterface:
        return {}
    return robot.values.field_types(f"{action_type}_Goal")
