"""Actions: which there are, and of what type."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ros2_mcp.model import names
from ros2_mcp.model.errors import NotFound, TypeConflict, UnknownInterface
from ros2_mcp.robot import Robot


@dataclass(frozen=True, slots=True)
class ActionEntry:
    """One action; `request_fields` is name → type of its goal."""

    name: str
    types: Sequence[str]
    request_fields: dict[str, Any]


@dataclass(frozen=True, slots=True)
class ActionList:
    """The actions that have a server."""

    actions: Sequence[ActionEntry]

    def summary(self) -> str:
        """One line."""
        return f"{len(self.actions)} action(s)."


async def list_actions(robot: Robot, pattern: str = "") -> ActionList:
    """The actions with their types and the fields of their goals."""
    known = await action_types(robot)
    chosen = names.matching(sorted(known), pattern)
    return ActionList([ActionEntry(name, known[name], await _goal_fields(robot, known[name][0])) for name in chosen])


async def action_types(robot: Robot) -> dict[str, list[str]]:
    """Action → its types, of every action with a server or a client in the graph."""
    ending = "/_action/send_goal"
    return {
        row.name.removesuffix(ending): [kind.removesuffix("_SendGoal") for kind in row.types]
        for row in await robot.graph.services()
        if row.name.endswith(ending)
    }


async def resolve_type(robot: Robot, action: str, asked: str = "") -> str:
    """The type of an action: the asked one, or the one that the graph knows.

    Raises:
        NotFound: if no such action is there.
        TypeConflict: if it has another type than the asked one, or several and none is asked for.
    """
    known = await action_types(robot)
    types = known.get(action, [])
    wanted = names.interface_type(asked, "action") if asked else ""
    if not types:
        hint = names.did_you_mean(action, list(known), "ros2_list_actions shows what is there.")
        raise NotFound(f"There is no action {action}: no server offers it.", hint)
    if wanted and wanted not in types:
        raise TypeConflict(f"{action} has the type {' and '.join(types)}, not {wanted}.", "Leave the type out.")
    if not wanted and len(types) > 1:
        raise TypeConflict(f"{action} has {len(types)} types: {', '.join(types)}.", "Give the type you mean.")
    return wanted or types[0]


async def _goal_fields(robot: Robot, action_type: str) -> dict[str, Any]:
    try:
        await robot.values.learn(action_type)
    except UnknownInterface:
        return {}
    return robot.values.field_types(f"{action_type}_Goal")
