"""`ros2_list_actions`: the actions of the robot, with the fields of their goals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ros2_mcp.model import names
from ros2_mcp.model.errors import UnknownInterface
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
    types = await robot.types.actions()
    entries: list[ActionEntry] = []
    for name in names.matching(sorted(types), pattern):
        action_type = types[name][0]
        try:
            await robot.values.learn(action_type)
            fields = robot.values.field_types(f"{action_type}_Goal")
        except UnknownInterface:  # the action can be named, though its goals cannot be described here
            fields = {}
        entries.append(ActionEntry(name, types[name], fields))
    return ActionList(entries)
