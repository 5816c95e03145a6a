"""The facts that a policy needs besides the command: the full value, other publishers, and states of joints."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from ros2_mcp.guard.policy import Facts
from ros2_mcp.model.commands import SendGoal, ServiceBorne
from ros2_mcp.model.errors import BadValue
from ros2_mcp.robot.core import Core
from ros2_mcp.robot.joints import RobotJoints
from ros2_mcp.robot.prepared import Prepared
from ros2_mcp.robot.seen import is_of_robot
from ros2_mcp.robot.told_of_trajectories import told_of
from ros2_mcp_common.policy.rules import Ruling, judged_part
from ros2_mcp_common.policy.stamps import trajectories_in
from ros2_mcp_common.policy.trajectory_limits import MAX_JOINTS
from ros2_mcp_common.policy.verbs import meaning


async def facts_of(
    core: Core, prepared: Prepared[Any], joints: RobotJoints, ruling: Ruling | None, with_value: bool = False
) -> Facts:
    """Collect the facts that the ruling on a command needs; with `with_value` also its value and sentences about it.

    Raises:
        BadValue: if the value does not fit its definition.
    """
    command = prepared.command
    is_asked = with_value or (ruling is not None and ruling.needs_value)
    value = await _judged(prepared) if is_asked and prepared.has_value else None
    facts = Facts(value=value)
    if value is not None and isinstance(command, SendGoal) and command.route:
        goals = [prepared.changed(replace(command, value=goal)) for goal in command.route.goals]
        facts = replace(facts, route=[await _judged(each) for each in goals])
    if value is None and ruling and ruling.curves:
        await joints.look()  # the bridge alone sees the trajectories of a relay or playback, and needs the limits
    trajectories = list(trajectories_in(value)) if with_value or (ruling and ruling.curves) else []
    if trajectories:
        names = dict.fromkeys(str(name) for _, found in trajectories for name in found["joint_names"])
        look = await joints.look(list(names)[:MAX_JOINTS])
        told = told_of(trajectories, look, await joints.urdf()) if with_value else ()
        facts = replace(facts, joints=look, told=told)
    if isinstance(command, ServiceBorne) or ruling is None or not ruling.needs_publishers:
        return facts
    present = await core.graph.endpoints(command.name)
    publishers = [
        publisher.node
        for publisher in present.publishers
        if publisher.type == command.type and not publisher.ours and is_of_robot(publisher.node)
    ]
    return replace(facts, publishers=sorted(set(publishers)))


async def _judged(prepared: Prepared[Any]) -> object:
    """Return the part of the full value that rules check: the message, the goal, or the parameters by name."""
    command, full = prepared.command, await prepared.full()
    if not isinstance(command, ServiceBorne):
        return full
    try:
        return judged_part(meaning(command.service, command.service_type).verb, full)
    except ValueError as error:
        raise BadValue("parameters", f"{error}.", "Give it once.") from error
