"""Listing services, as `ros2 service list` does, with what a call needs: request fields and the nodes that answer."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence, Set
from dataclasses import dataclass
from typing import Any

from ros2_mcp.model import names
from ros2_mcp.model.errors import BadName, NotFound, UnknownInterface
from ros2_mcp.ops.results import list_note
from ros2_mcp.robot import Robot
from ros2_mcp.robot.resolution import is_infrastructure


@dataclass(frozen=True, slots=True)
class ServiceEntry:
    """One service; `request_fields` is name → type, `providers` are the nodes that serve it."""

    service_name: str
    service_type: str
    request_fields: dict[str, Any]
    providers: Sequence[str]


@dataclass(frozen=True, slots=True)
class ServiceList:
    """The services of the graph."""

    services: Sequence[ServiceEntry]
    total: int
    settled: bool
    note: str

    def summary(self) -> str:
        """One line."""
        return f"{len(self.services)} of {self.total} services. {self.note}".rstrip()


async def list_services(robot: Robot, pattern: str = "", include_hidden: bool = False, limit: int = 200) -> ServiceList:
    """The services whose names match the pattern. Those that every node has are shown only with `include_hidden`."""
    found = await robot.graph.services()
    types = {row.name: row.types for row in found}
    visible = [name for name in sorted(types) if include_hidden or not is_infrastructure(name, types[name])]
    matching = names.matching(visible, pattern)
    chosen = [(name, types[name][0]) for name in matching[:limit]]
    providers, fields = await asyncio.gather(_providers(robot), _request_fields(robot, {kind for _, kind in chosen}))
    entries = [ServiceEntry(name, kind, fields[kind], providers.get(name, [])) for name, kind in chosen]
    left_out = len(types) - len(visible)
    note = f"{left_out} that every node has (for parameters, actions) are left out. " if left_out else ""
    note += list_note(len(matching), limit, found.settled)
    return ServiceList(entries, len(types), found.settled, note.rstrip())


async def _providers(robot: Robot) -> dict[str, list[str]]:
    """Service → the full names of the nodes that serve it. ROS 2 answers this only node by node."""

    async def served_by(node: str) -> list[str]:
        try:
            return [entry.name for entry in (await robot.graph.node(node)).servers]
        except (NotFound, BadName):  # it has gone meanwhile, or the middleware has no name for it
            return []

    nodes = [row.name for row in await robot.graph.nodes()]
    providers: dict[str, list[str]] = {}
    for node, services in zip(nodes, await asyncio.gather(*(served_by(node) for node in nodes)), strict=True):
        for service in services:
            providers.setdefault(service, []).append(node)
    return providers


async def _request_fields(robot: Robot, types: Set[str]) -> dict[str, dict[str, Any]]:
    """Type → name → type; nothing under a type that is not installed where the bridge runs: its service is listed."""
    fields: dict[str, dict[str, Any]] = {}
    for service_type in sorted(types):
        try:
            await robot.values.learn(service_type)
            fields[service_type] = robot.values.field_types(f"{service_type}_Request")
        except UnknownInterface:
            fields[service_type] = {}
    return fields
