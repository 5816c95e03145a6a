"""What a decision needs besides the command: the full value, and who else publishes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from ros2_mcp.guard.policy import Facts, Policy
from ros2_mcp.model.commands import Command, Move, Publish, Repeat, ServiceBorne
from ros2_mcp.model.errors import BadValue
from ros2_mcp.robot.core import Core
from ros2_mcp.robot.joints import RobotJoints
from ros2_mcp.robot.seen import is_of_robot
from ros2_mcp.robot.told_of_trajectories import told_of
from ros2_mcp_common.policy.rules import judged_part, meaning
from ros2_mcp_common.policy.stamps import trajectories_in
from ros2_mcp_common.policy.trajectory_limits import MAX_JOINTS


async def facts_of(
    core: Core, command: Command[Any], policy: Policy, joints: RobotJoints, with_value: bool = False
) -> Facts:
    """What the policy needs to know about a command, and its value in any case if asked for that.

    Raises:
        BadValue: if the value does not fit its definition.
    """
    is_asked, ruling = with_value, policy.ruling(command)
    value = await _value_of(core, command) if with_value or policy.needs_value(command) else None
    facts = Facts(value=value)
    if value is None and ruling and ruling.curves:
        await joints.look()  # of a relay or playback the bridge alone sees the trajectories
    trajectories = list(trajectories_in(value)) if is_asked or (ruling and ruling.curves) else []
    if trajectories:
        names = dict.fromkeys(str(name) for _, found in trajectories for name in found["joint_names"])
        look = await joints.look(list(names)[:MAX_JOINTS])
        told = told_of(trajectories, look, await joints.urdf()) if is_asked else ()
        facts = replace(facts, joints=look, told=told)
    if isinstance(command, ServiceBorne) or not policy.needs_publishers(command):
        return facts
    present = await core.graph.endpoints(command.name)
    publishers = [
        publisher.node
        for publisher in present.publishers
        if publisher.type == command.type and not publisher.ours and is_of_robot(publisher.node)
    ]
    return replace(facts, publishers=sorted(set(publishers)))


async def _value_of(core: Core, command: Command[Any]) -> object:
    """The full value as it will be sent; None of what has none."""
    if isinstance(command, ServiceBorne):
        kind = f"{command.service_type}_Request"
        body = await core.values.encode(kind, command.request)
        request = await core.values.in_full(kind, body)
        try:
            return judged_part(meaning(command.service, command.service_type).verb, request)
        except ValueError as error:
            raise BadValue("parameters", f"{error}.", "Give it once.") from error
    if isinstance(command, Publish | Repeat | Move):
        return await core.values.in_full(command.type, await core.values.encode(command.type, command.value))
    return None
