"""Interfaces: the definitions of messages, services and actions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ros2_mcp.model import names
from ros2_mcp.model.errors import BadName, UnknownInterface
from ros2_mcp.robot import Robot

if TYPE_CHECKING:
    from ros2_mcp.model.interfaces import Interface

KINDS = ("msg", "srv", "action")


@dataclass(frozen=True, slots=True)
class InterfaceList:
    """Names of interfaces, sorted."""

    interfaces: Sequence[str]
    total: int
    note: str

    def summary(self) -> str:
        """One line."""
        return f"{len(self.interfaces)} of {self.total} interfaces. {self.note}".rstrip()


@dataclass(frozen=True, slots=True)
class Definition:
    """The whole definition of an interface, and an example value for each of its sides, ready to fill in.

    `text` is the definition as a listing with every nested type; `examples` has the key `message`, or `request` and
    `response`, or `goal`, `result` and `feedback`.
    """

    message_type: str
    kind: str
    fields: dict[str, Any]
    text: str
    examples: dict[str, Any]
    hash: str

    def summary(self) -> str:
        """One line."""
        return f"{self.message_type} ({self.kind})"


async def list_interfaces(
    robot: Robot, pattern: str = "", kind: str = "", package: str = "", limit: int = 200
) -> InterfaceList:
    """The interfaces installed where the bridge runs."""
    if kind and kind not in KINDS:
        raise BadName(f"{kind!r} is not a kind of interface.", f"Give one of {', '.join(KINDS)}.")
    every = await robot.graph.interfaces()
    chosen = [
        name
        for name in names.matching(every, pattern)
        if (not kind or f"/{kind}/" in name) and (not package or name.startswith(package + "/"))
    ]
    note = f"{len(chosen)} match, the first {limit} are shown." if len(chosen) > limit else ""
    return InterfaceList(chosen[:limit], len(every), note)


async def define(robot: Robot, type_name: str) -> Definition:
    """The definition of a message, service or action; `pkg/Name` finds the kind by itself.

    Raises:
        UnknownInterface: if it is not installed where the bridge runs.
    """
    full = await _full_name(robot, type_name)
    await robot.values.learn(full)
    interface = robot.values.definitions.interface(full)
    sides = {section.name: f"{section.type}" for section in interface.sections}
    return Definition(
        full,
        interface.kind,
        _fields(interface),
        interface.text(),
        {side: robot.values.example(name) for side, name in sides.items()},
        robot.values.definitions.hash(full) if interface.kind == "msg" else "",
    )


def _fields(interface: Interface) -> dict[str, Any]:
    """Name → type of the top-level fields; one level deeper for a service's and an action's sides."""
    sides = {section.name: {f.name: str(f.type) for f in section.fields} for section in interface.sections}
    return sides["message"] if interface.kind == "msg" else sides


async def _full_name(robot: Robot, type_name: str) -> str:
    text = type_name.strip()
    if text.count("/") == 2:
        return names.interface_type(text, text.split("/")[1])
    candidates = [names.interface_type(text, kind) for kind in KINDS]
    installed = await robot.graph.interfaces()
    found = [name for name in candidates if name in installed]
    if not found:
        near = names.did_you_mean(candidates[0], installed, "ros2_interface_list shows what is there.")
        raise UnknownInterface(f"{type_name} is not installed where the bridge runs.", near)
    return found[0]
