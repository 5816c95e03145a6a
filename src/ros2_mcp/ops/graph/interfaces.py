"""List interfaces and show their definitions, as `ros2 interface list` and `ros2 interface show` do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from ros2_mcp.model import names
from ros2_mcp.model.errors import BadName
from ros2_mcp.model.text import counted_of
from ros2_mcp.ops.results.results import IF_ANY, LINES, SAID, list_note
from ros2_mcp.robot import Robot


@dataclass(frozen=True, slots=True)
class InterfaceList:
    """Names of interfaces, sorted."""

    interfaces: Sequence[str]
    total: int = field(metadata=SAID)
    note: str = field(metadata=IF_ANY)

    def summary(self) -> str:
        """Return the result in one line."""
        return f"{counted_of(len(self.interfaces), self.total, 'interface')}. {self.note}".rstrip()


@dataclass(frozen=True, slots=True, kw_only=True)
class Definition:
    """The whole definition of an interface, with an example value for each side, ready to fill in.

    `fields` maps names to types; for a service or action it is one level deeper: side → name → type. `text` is the
    definition with every nested type; `examples` has the key `message`, or `request` and `response`, or `goal`,
    `result` and `feedback`.
    """

    message_type: str = field(metadata=SAID)
    kind: str = field(metadata=SAID)
    fields: dict[str, Any]
    text: str = field(metadata=LINES)
    examples: dict[str, Any]
    hash: str

    def summary(self) -> str:
        """Return the result in one line."""
        return f"{self.message_type} ({self.kind})"


async def list_interfaces(
    robot: Robot, pattern: str = "", kind: str = "", package: str = "", limit: int = 200
) -> InterfaceList:
    """Return the interfaces that are installed where the bridge runs; for a recording, the interfaces in it."""
    if kind and kind not in names.KINDS:
        raise BadName(f"{kind!r} is not a kind of interface.", f"Give one of {', '.join(names.KINDS)}.")
    installed = [name for name in await robot.graph.interfaces() if not names.is_derived(name)]
    chosen = [
        name
        for name in names.matching(installed, pattern)
        if (not kind or f"/{kind}/" in name) and (not package or name.startswith(package + "/"))
    ]
    return InterfaceList(chosen[:limit], len(installed), list_note(len(chosen), limit))


async def define(robot: Robot, type_name: str) -> Definition:
    """Return the definition of a message, service or action. `pkg/Name` and `Name` are completed to the full name.

    Raises:
        TypeConflict: if several interfaces have this name.
        UnknownInterface: if it is not installed where the bridge runs.
    """
    full = await robot.types.full_name(type_name)
    await robot.values.learn(full)
    interface = robot.values.definitions.interface(full)
    fields = {side: {field.name: str(field.type) for field in made.fields} for side, made in interface.sides.items()}
    is_message = interface.kind == "msg"
    return Definition(
        message_type=full,
        kind=interface.kind,
        fields=fields["message"] if is_message else fields,
        text=interface.text(),
        examples={side: robot.values.example(made.type) for side, made in interface.sides.items()},
        hash=robot.values.definitions.hash(full) if is_message else "",
    )
