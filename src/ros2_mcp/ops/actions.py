"""Actions: which there are, and of what type."""

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
    known = await robot.types.actions()
    chosen = names.matching(sorted(known), pattern)
    return ActionList([ActionEntry(name, known[name], await _goal_fields(robot, known[name][0])) for name in chosen])


async def _goal_fields(robot: Robot, action_type: str) -> dict[str, Any]:
    try:
        await robot.values.learn(action_type)
    except UnknownInterface:
        return {}
    return robot.values.field_types(f"{action_type}_Goal")
