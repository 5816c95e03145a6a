"""`ros2_cancel_action_goal`: one goal, all goals, or those accepted up to a time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from ros2_mcp.model import names
from ros2_mcp.model.commands import CancelGoals
from ros2_mcp.model.errors import BadValue
from ros2_mcp.model.goals import CANCEL_CODES, goal_id_bytes, goal_id_hex
from ros2_mcp.model.text import counted
from ros2_mcp.ops.results.results import IF_ANY
from ros2_mcp.robot import Robot
from ros2_mcp.robot.goals import UNKNOWN_GOAL, Goal
from ros2_mcp.robot.session import Session

_NOTES: Mapping[int, str] = {
    1: "The server refused to cancel.",
    UNKNOWN_GOAL: "The server does not know this goal.",
    3: "The goal had already ended.",
}
"""The meaning of each code of a refusal."""


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
    note: str = field(metadata=IF_ANY)

    def summary(self) -> str:
        """Return the result in one line."""
        refused = f"{self.return_code_text}: " if self.return_code else ""
        return f"{refused}Cancelling {counted(len(self.goals_canceling), 'goal')}. {self.note}".rstrip()


async def cancel(
    robot: Robot,
    session: Session,
    action: str,
    goal_id: str = "",
    *,
    cancel_all: bool = False,
    stamp: Mapping[str, int] | None = None,
    timeout_s: float = 3.0,
) -> Cancellation:
    """Ask the action server to cancel one goal, or all goals with `cancel_all`. With `stamp`: also the goals accepted
    up to it; with `cancel_all`, only those goals.

    Raises:
        BadValue: if neither a goal id nor `cancel_all` is given, or the goal id is malformed.
        NotFound: if there is no such action.
        TimedOut: if the server did not answer.
    """
    action = names.absolute(action, "action")
    if not goal_id and not cancel_all:
        raise BadValue("goal_id_hex", "no goal id is given.", "Give its id, or set cancel_all to cancel every goal.")
    chosen = goal_id_hex(goal_id_bytes(goal_id)) if goal_id else ""
    await robot.types.action(action)
    command = CancelGoals(
        principal=session.principal, name=action, goal_id="" if cancel_all else chosen, stamp=stamp, timeout_s=timeout_s
    )
    response = await robot.fields_of(await robot.do(command, session))
    return _cancellation(command.service, response, cancel_all=cancel_all)


def _cancellation(service: str, response: Mapping[str, Any], *, cancel_all: bool = False) -> Cancellation:
    code = int(response["return_code"])
    goals = [CancelledGoal(goal_id_hex(goal["goal_id"]["uuid"]), goal["stamp"]) for goal in response["goals_canceling"]]
    if code:
        note = _NOTES.get(code, "")
    elif goals:
        note = "ros2_action_request_result reports when the server has stopped it."
    elif cancel_all:
        note = "No goal was running, or the server refused."
    else:
        note = "The server refused to cancel this goal."
    return Cancellation(service, code, CANCEL_CODES.get(code, str(code)), goals, note)


async def cancel_sent(goal: Goal, within_s: float) -> Cancellation:
    """Cancel a goal that this server sent, as `Goal.request_cancel` does.

    Raises:
        NotFound: if there is no such action.
        TimedOut: if the server did not answer.
    """
    return _cancellation(f"{goal.action}/_action/cancel_goal", await goal.request_cancel(within_s))
