"""`ros2_cancel_action_goal`: one goal, all goals, or those accepted up to a time."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from time import monotonic
from typing import Any

from ros2_mcp.model import names
from ros2_mcp.model.commands import CancelGoals
from ros2_mcp.model.errors import BadValue
from ros2_mcp.model.goals import CANCEL_CODES, goal_id_bytes, goal_id_hex
from ros2_mcp.robot import Robot
from ros2_mcp.robot.goals import Goal

UNKNOWN_GOAL = 2
"""A code of action_msgs/srv/CancelGoal (`CANCEL_CODES`)."""
_AGAIN_S = 0.1
"""Between requests to cancel a goal that its server has yet to accept."""
_NOTES: Mapping[int, str] = {
    1: "The server refuses to cancel.",
    UNKNOWN_GOAL: "The server does not know such a goal.",
    3: "The goal had ended already.",
}
"""What the codes of refusals mean."""


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
        BadValue: if there is neither a goal id nor `cancel_all`, or what is given is no goal id.
        NotFound: if no such action is there.
        TimedOut: if the server did not answer.
    """
    action = names.absolute(action, "action")
    if not goal_id and not cancel_all:
        raise BadValue("goal_id_hex", "no goal is named.", "Give its id, or set cancel_all to cancel every goal.")
    chosen = goal_id_hex(goal_id_bytes(goal_id)) if goal_id else ""
    await robot.types.action(action)
    command = CancelGoals(
        principal=robot.principal, name=action, goal_id="" if cancel_all else chosen, stamp=stamp, timeout_s=timeout_s
    )
    response = robot.fields_of(await robot.do(command))
    code = int(response["return_code"])
    goals = [CancelledGoal(goal_id_hex(goal["goal_id"]["uuid"]), goal["stamp"]) for goal in response["goals_canceling"]]
    if code:
        note = _NOTES.get(code, "")
    elif goals:
        note = "A goal ends when the server has stopped it: ros2_action_request_result tells."
    elif cancel_all:
        note = "Nothing was running, or the server refuses."
    else:
        note = "The server refuses to cancel this goal."
    return Cancellation(command.service, code, CANCEL_CODES.get(code, str(code)), goals, note)


async def cancel_sent(robot: Robot, action: str, goal_id: str, within_s: float) -> Cancellation:
    """Cancels a goal of ours. A server that has yet to accept it does not know it: it is asked again, for `within_s`.

    Raises:
        NotFound: if no such action is there.
        TimedOut: if the server did not answer.
    """
    deadline = monotonic() + within_s
    while True:
        goal = robot.jobs.get(Goal, goal_id)
        is_on_its_way = goal and goal.is_running and not goal.is_accepted
        answer = await cancel(robot, action, goal_id)
        if answer.return_code != UNKNOWN_GOAL or not is_on_its_way or monotonic() > deadline:
            return answer
        await asyncio.sleep(_AGAIN_S)
