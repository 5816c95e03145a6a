"""`ros2_action_request_result`: the result of a goal of any client."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field
from time import monotonic
from typing import Any

from ros2_mcp.guard.policy import bounded
from ros2_mcp.model import names
from ros2_mcp.model.errors import LEASE, NotFound, TimedOut
from ros2_mcp.model.goals import STATUS, TERMINAL, goal_id_bytes, goal_id_hex
from ros2_mcp.ops.acting.endings import ended_by, reason_of
from ros2_mcp.ops.actions.cancel_when import note_on
from ros2_mcp.ops.actions.nav_results import told_by_result
from ros2_mcp.ops.actions.status import SERVER_S, states_now
from ros2_mcp.ops.results.results import SAID, Report, reporting, silent
from ros2_mcp.robot import Answer, Robot
from ros2_mcp.robot.goals import Goal
from ros2_mcp_common.wire.limits import MAX_DURATION_S

STATUS_AFTER_S = 1.0
"""Answers come within milliseconds; after this the action's status is read, in case the answer was lost."""
_STATUS_EVERY_S = 3.0
"""Seconds between two reads of the status, each of which costs a subscription. A result whose answer
was lost comes that much later."""
_AT_LEAST_S = 0.1
"""The least time-out of a service call, so that a result that is ready arrives even if no time is left."""


@dataclass(frozen=True, slots=True)
class GoalResult:
    """The result of a goal from any client; `status` is `TIMEOUT` (code 0) if the goal had not ended in time."""

    service: str
    goal_id: str = field(metadata=SAID)
    waited: bool
    result_timeout_sec: float | None
    status_code: int
    status: str = field(metadata=SAID)
    result: dict[str, Any] | None = None
    note: str = ""

    def summary(self) -> str:
        """Return the result in one line."""
        return f"goal {self.goal_id}: {self.status}. {self.note}".rstrip()


async def request_result(
    robot: Robot,
    action: str,
    action_type: str,
    goal_id: str,
    *,
    timeout_s: float | None = 60.0,
    wait_for_service_s: float = SERVER_S,
    waits: bool = True,
    report: Report = silent,
) -> GoalResult:
    """Wait for the result of a goal of any client. With `waits`, also wait for the action server to appear. A time-out
    does not cancel the goal.

    Raises:
        NotFound: if there is no such action, or its server left before the goal ended.
        BadValue: if the goal id is malformed.
    """
    action = names.absolute(action, "action")
    wait_s = MAX_DURATION_S if timeout_s is None else bounded("timeout_sec", timeout_s, 0.0, MAX_DURATION_S, "s")
    goal_id = goal_id_hex(goal_id_bytes(goal_id))
    is_awaited = waits and bool(action_type) and action not in await robot.types.actions()
    if is_awaited:
        near = await robot.types.near_action(action)
        await report(0.0, wait_s, f"Waiting for the action {action}. {near}")
        action_type = await robot.types.full_name(action_type, "action")  # its server may not have appeared yet
    known = known_of(robot, action, goal_id)
    try:
        if not is_awaited:
            action_type = await robot.types.action(action, action_type)
        async with reporting(report, wait_s, f"waiting for the result of {action}"):
            return await result_of(robot, action, action_type, goal_id, timeout_s, wait_for_service_s)
    except NotFound as error:
        if not known:
            raise
        note = f"{error.message} {known}"
        return GoalResult(f"{action}/_action/get_result", goal_id, True, timeout_s, 0, STATUS[0], note=note)


def known_of(robot: Robot, action: str, goal_id: str) -> str:
    """Return a sentence on a goal that this server sent; empty for any other goal."""
    goal = robot.jobs.get(Goal, goal_id)
    if goal is None or goal.action != action:
        return ""
    was = "it was accepted" if goal.is_accepted else "it is not known to have been accepted"
    is_known = goal.ended_as in {STATUS[code] for code in TERMINAL}
    how = f"it was seen to end: {goal.ended_as}" if is_known else "how it ended is not known"
    return f"This server sent it {monotonic() - goal.started_at:.0f} s ago, {was}; {how}."


async def result_of(
    robot: Robot,
    action: str,
    action_type: str,
    goal_id: str,
    timeout_s: float | None,
    wait_for_service_s: float = SERVER_S,
) -> GoalResult:
    """Wait for the result of a goal, given resolved names. Raises `NotFound` if the server left before the goal ended.

    The action server answers `get_result` when the goal ends. A lost answer (the server had not discovered our client
    yet) is never sent again. So the action's status is read meanwhile, and a lost result is requested again.
    """
    service, service_type = f"{action}/_action/get_result", f"{action_type}_GetResult"
    request = {"goal_id": {"uuid": goal_id_bytes(goal_id)}}
    wait_s = MAX_DURATION_S if timeout_s is None else timeout_s
    deadline = monotonic() + wait_s
    while True:
        left_s = max(deadline - monotonic(), _AT_LEAST_S)
        asking = asyncio.ensure_future(
            robot.ask_service(service, service_type, request, timeout_s=left_s, wait_s=wait_for_service_s)
        )
        try:
            if await _is_lost(robot, action, goal_id, asking):
                continue
            answer = await asking
            break
        except NotFound as error:
            raise NotFound(f"The server of {action} is not running, or left before the goal ended.") from error
        except TimedOut:
            note = f"No result within {wait_s:g} s; the goal was not cancelled. Ask again with this goal id."
            return GoalResult(service, goal_id, True, timeout_s, 0, "TIMEOUT", note=note)
        finally:
            asking.cancel()
    response = (await robot.values.render(answer.type, answer.body)).value
    code = int(response["status"])
    if code in TERMINAL or code == 0:
        robot.goal_ended(action, goal_id, STATUS.get(code, ""))
    known = known_of(robot, action, goal_id) if code == 0 else ""
    note = ""
    if known:
        note = f"The server does not know this goal any more: it was started again, or has dropped it. {known}"
    elif code == 0:
        note = "The server does not know this goal: the id is wrong, or the server has dropped the goal."
    goal = robot.jobs.get(Goal, goal_id)
    if STATUS.get(code) == "CANCELED" and goal and robot.graph.lapsed_at > goal.started_at:
        note = ended_by(LEASE)
    elif STATUS.get(code) == "CANCELED" and goal and robot.graph.latched_at > goal.started_at:
        note = ended_by(reason_of(robot, "latch"))
    elif STATUS.get(code) == "CANCELED" and goal and robot.graph.kept_out_at > goal.started_at:
        note = ended_by(reason_of(robot, "keep_out"))
    result = response["result"] if code in TERMINAL else None
    note = " ".join(filter(None, (told_by_result(action_type, result), note, note_on(robot, goal_id))))
    return GoalResult(service, goal_id, True, timeout_s, code, STATUS.get(code, str(code)), result, note)


async def _is_lost(robot: Robot, action: str, goal_id: str, asking: asyncio.Future[Answer]) -> bool:
    """Wait for the answer. Return True if none comes although the action's status says that the goal has ended."""
    while not (await asyncio.wait({asking}, timeout=_STATUS_EVERY_S))[0]:
        ended = {state.goal_id for state in await states_now(robot, action) if state.status_code in TERMINAL}
        if goal_id in ended:
            return not (await asyncio.wait({asking}, timeout=STATUS_AFTER_S))[0]
    return False
