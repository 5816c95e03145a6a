"""Translate a service call that sets parameters, makes a transition, or sends or cancels goals into that command.

It is then decided, tracked and stopped as that command, whichever tool it came from.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

from ros2_mcp.model import commands, parameters
from ros2_mcp.model.commands import ServiceBorne, ServiceCall
from ros2_mcp.model.errors import BadValue
from ros2_mcp.model.goals import goal_id_hex
from ros2_mcp.robot.prepared import Prepared
from ros2_mcp_common.policy.verbs import meaning


async def as_meant(prepared: Prepared[Any]) -> Prepared[Any]:
    """Return the command that a service call amounts to (set parameters, make a transition, send or cancel goals), with
    the call's bytes; return any other command unchanged. The call's request is checked first.

    Raises:
        BadValue: if the request does not fit the definition of the service's type.
    """
    command = prepared.command
    if not isinstance(command, ServiceCall) or meaning(command.name, command.type).verb in ("call", "read"):
        return prepared
    return prepared.meaning(_meant(command, await prepared.full()))


def _meant(command: ServiceCall, request: Mapping[str, Any]) -> ServiceBorne:
    kind, meant = command.type, meaning(command.name, command.type)
    common: dict[str, Any] = {
        "principal": command.principal,
        "risk": command.risk,
        "timeout_s": command.timeout_s,
        "wait_s": command.wait_s,
        "name": meant.name,
    }
    of_node: dict[str, Any] = {"through": command.name, "type": kind, "value": command.value}
    if meant.verb == "transition":
        transition = request["transition"]
        return commands.ChangeState(
            **common, **of_node, transition=transition["label"], transition_id=int(transition["id"])
        )
    if meant.verb == "set":
        plain = {entry["name"]: parameters.value_of(entry["value"]) for entry in request["parameters"]}
        return commands.SetParameters(**common, **of_node, parameters=plain)
    if meant.verb == "goal":
        goal_id = goal_id_hex(request["goal_id"]["uuid"])
        if not int(goal_id, 16):
            raise BadValue("goal_id.uuid", "all zeros mean every goal, not one.", "Give 16 random bytes.")
        goal = cast("dict[str, Any]", command.value).get("goal", {})
        return commands.SendGoal(**common, type=meant.type, value=goal, goal_id=goal_id)
    goal_id = goal_id_hex(request["goal_info"]["goal_id"]["uuid"])
    one = goal_id if int(goal_id, 16) else ""
    return commands.CancelGoals(**common, goal_id=one, stamp=request["goal_info"]["stamp"], value=command.value)
