"""What a decision needs besides the command: the full value, and who else publishes."""

from __future__ import annotations

from typing import Any

from ros2_mcp.guard.policy import Facts, Policy
from ros2_mcp.model.commands import Command, Move, Publish, Repeat, ServiceBorne
from ros2_mcp.model.errors import BadValue
from ros2_mcp.robot.core import Core
from ros2_mcp.robot.seen import is_of_robot
from ros2_mcp_bridge.rules import judged_part, meaning


async def facts_of(core: Core, command: Command[Any], policy: Policy, *, with_value: bool) -> Facts:
    """What the policy needs to know about a command, and its value in any case if asked for that.

    Raises:
        BadValue: if the value does not fit its definition.
    """
    with_value = with_value or policy.needs_value(command)
    if isinstance(command, ServiceBorne):
        kind = f"{command.service_type}_Request"
        body = await core.values.encode(kind, command.request)
        request = await core.values.in_full(kind, body)
        try:
            return Facts(value=judged_part(meaning(command.service, command.service_type).verb, request))
        except ValueError as error:
            raise BadValue("parameters", f"{error}.", "Give it once.") from error
    value: object = None
    if isinstance(command, Publish | Repeat | Move) and with_value:
        value = await core.values.in_full(command.type, await core.values.encode(command.type, command.value))
    if not policy.needs_publishers(command):
        return Facts(value=value)
    present = await core.graph.endpoints(command.name)
    publishers = [
        publisher.node
        for publisher in present.publishers
        if publisher.type == command.type and not publisher.ours and is_of_robot(publisher.node)
    ]
    return Facts(value=value, publishers=sorted(set(publishers)))
