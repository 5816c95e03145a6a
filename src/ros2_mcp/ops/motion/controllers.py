"""Find joint trajectory controllers in the graph, by their topics and actions, and the joints that they move."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import cast

from ros2_mcp.model import names
from ros2_mcp.model.errors import BadInput, NotFound
from ros2_mcp.model.text import listed, named
from ros2_mcp.ops.space.description import parameter_of
from ros2_mcp.robot import Robot

TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
FOLLOW = "control_msgs/action/FollowJointTrajectory"
_TOPIC, _ACTION = "/joint_trajectory", "/follow_joint_trajectory"
"""Names of topic and action below the controller's own name, as ros2_control gives them."""
_MOST = 16


@dataclass(frozen=True, slots=True)
class Controller:
    """A controller: its name, its action and topic ("" if it has none), and its joints (empty: unknown)."""

    name: str
    action: str = ""
    topic: str = ""
    joints: Sequence[str] = ()

    @property
    def interface(self) -> str:
        """The interface by which it is commanded: its action, which reports progress, else its topic."""
        return self.action or self.topic

    def may_move(self, joints: Sequence[str]) -> bool:
        """Return whether it has all of these joints, as far as its joints are known."""
        return not self.joints or set(joints) <= set(self.joints)


async def controller_for(robot: Robot, joints: Sequence[str], given: str = "") -> Controller:
    """Return the controller that moves these joints: the controller with the given name, topic or action; else the only
    controller that can.

    Raises:
        NotFound: if there is no controller of that name, or none at all.
        BadInput: if no controller has all of the joints, or several may have them.
    """
    found = await controllers(robot)
    if not found:
        raise await robot.graph.missing(
            f"There is no joint trajectory controller: no action has the type {FOLLOW}, and no topic of type "
            f"{TRAJECTORY} has a subscriber.",
            "ros2_list_actions and ros2_topic_list show what there is.",
        )
    if given:
        found = dict(_chosen(found, names.absolute(given)))
    fitting = [one for one in found.values() if one.may_move(joints)]
    sure = [one for one in fitting if one.joints]
    if len(sure or fitting) == 1:
        return (sure or fitting)[0]
    shown = "; ".join(
        f"{named(one.name)} moves {listed(one.joints, 8) or 'joints that it does not report'}" for one in found.values()
    )
    if not fitting:
        raise BadInput(f"No controller has all of {listed(joints, 8)}: {shown}.", "Move them with one call for each.")
    raise BadInput(f"Several controllers may move {listed(joints, 8)}: {shown}.", "Give controller.")


def _chosen(found: Mapping[str, Controller], given: str) -> Sequence[tuple[str, Controller]]:
    for name, one in found.items():
        if given == name:
            return [(name, one)]
        if given == one.action:
            return [(name, Controller(name, one.action, "", one.joints))]
        if given == one.topic:
            return [(name, Controller(name, "", one.topic, one.joints))]
    raise NotFound(
        f"There is no controller {named(given)}.",
        names.did_you_mean(given, list(found), f"There is {listed(list(found), 6)}."),
    )


async def controllers(robot: Robot) -> Mapping[str, Controller]:
    """Return the controllers in the graph, by name."""
    rows, actions = await asyncio.gather(robot.graph.topics(), robot.types.actions())
    by_action = {_name(action, _ACTION): action for action, types in actions.items() if FOLLOW in types}
    by_topic = {_name(row.name, _TOPIC): row.name for row in rows if TRAJECTORY in row.types and row.subscribers}
    ours = sorted({*by_action, *by_topic})[:_MOST]
    joints = await asyncio.gather(*(parameter_of(robot, name, "joints") for name in ours))
    return {
        name: Controller(name, by_action.get(name, ""), by_topic.get(name, ""), _texts(told))
        for name, told in zip(ours, joints, strict=True)
    }


def _name(of: str, suffix: str) -> str:
    return of.removesuffix(suffix) or of


def _texts(told: object) -> Sequence[str]:
    return [str(each) for each in cast("Sequence[object]", told)] if isinstance(told, (list, tuple)) else ()
