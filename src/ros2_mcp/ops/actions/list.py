"""`ros2_list_actions`: the actions of the robot, with the fields of their goals."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ros2_mcp.model import names
from ros2_mcp.model.text import counted
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
    note: str = ""

    def summary(self) -> str:
        """Return the result in one line."""
        return f"{counted(len(self.actions), 'action')}. {self.note}".rstrip()


async def list_actions(robot: Robot, pattern: str = "") -> ActionList:
    """Return the actions whose names or types match, with the fields of their goals."""
    types, absence = await asyncio.gather(robot.types.actions(), robot.graph.absence())
    chosen = names.matching(sorted(types), pattern, types.__getitem__)
    fields, unknown = await robot.values.fields_of((types[name][0] for name in chosen), "_Goal")
    entries = [ActionEntry(name, types[name], fields[types[name][0]]) for name in chosen]
    return ActionList(entries, " ".join(filter(None, (absence, unknown))))
