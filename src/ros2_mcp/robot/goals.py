"""Carrying out the commands for goals, through the services under `<action>/_action/`."""

from __future__ import annotations

from typing import Any

from ros2_mcp.model.commands import Answer, SendGoal
from ros2_mcp.model.errors import NotFound
from ros2_mcp.model.goals import CANCEL_TYPE
from ros2_mcp.robot.core import Core
from ros2_mcp.robot.services import call


async def send(core: Core, command: SendGoal) -> Answer:
    """Sends a goal that is known before it leaves: `ros2_stop` cancels it, and the bridge does if this process dies.

    It stays known until it is seen to end, unless its server does not take it. Raises as a `ServiceBorne`.
    """
    await core.values.learn(command.type, CANCEL_TYPE)
    core.values.encode_known(f"{command.type}_Goal", command.value)  # a goal that does not fit is not known
    core.goals.sent(command.goal_id, command.name, command.type)
    core.failsafes.leave_cancel(command.goal_id, command.name)
    try:
        answer = await call(core, command)
    except NotFound:
        core.goal_ended(command.goal_id)
        raise
    response: Any = core.values.codec.decode(answer.type, answer.body)
    if response.accepted:
        core.goals.accepted(command.goal_id)
    else:
        core.goal_ended(command.goal_id)
    return answer
