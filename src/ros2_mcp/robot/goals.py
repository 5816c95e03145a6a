"""Carrying out the commands for goals, through the services under `<action>/_action/`."""

from __future__ import annotations

from typing import Any

from ros2_mcp.model.commands import Answer, CancelGoals, SendGoal
from ros2_mcp.model.errors import NotFound
from ros2_mcp.model.goals import CANCEL_TYPE
from ros2_mcp.robot.core import Core
from ros2_mcp.robot.sent_goals import Goal
from ros2_mcp.robot.services import call

_CANCELLED_S = 3.0
"""A server that is alive answers within milliseconds; the end of a client does not wait longer for one that is not."""


async def send(core: Core, command: SendGoal) -> Answer:
    """Sends a goal that is known before it leaves: `ros2_stop` cancels it, and the bridge does if this process dies.

    It stays known until it is seen to end, unless its server does not take it. Raises as a `ServiceBorne`.
    """
    await core.values.learn(command.type, CANCEL_TYPE)
    core.values.encode_known(f"{command.type}_Goal", command.value)  # a goal that does not fit is not known
    former = core.jobs.get(Goal, command.goal_id)
    if former and former.is_running:  # its server refuses a second one of that id, and goes on with the first
        return await call(core, command)
    goal = await _known(core, command)
    core.failsafes.leave_cancel(command.goal_id, command.name)
    try:
        answer = await call(core, command)
    except NotFound:
        core.goal_ended(command.goal_id)
        raise
    response: Any = core.values.codec.decode(answer.type, answer.body)
    if response.accepted:
        goal.is_accepted = True
    else:
        core.goal_ended(command.goal_id)
    return answer


async def _known(core: Core, command: SendGoal) -> Goal:
    """The goal as a job."""
    cancel = CancelGoals(
        principal=command.principal, name=command.name, goal_id=command.goal_id, timeout_s=_CANCELLED_S
    )
    goal = Goal(
        owner=command.principal,
        goal_id=command.goal_id,
        action=command.name,
        action_type=command.type,
        ask_to_cancel=lambda: call(core, cancel),
    )
    await core.jobs.start(goal)
    return goal
