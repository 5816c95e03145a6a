"""List services, as `ros2 service list` does, with what a call needs: request fields and the nodes that serve it."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from ros2_mcp.model import names
from ros2_mcp.model.errors import BadName, NotFound
from ros2_mcp.model.text import counted_of
from ros2_mcp.ops.results.results import IF_ANY, SAID, list_note
from ros2_mcp.robot import Robot
from ros2_mcp.robot.resolution import is_infrastructure

_FEW_LIFECYCLE = 20
"""The most lifecycle services that are listed unasked: the services of four nodes. Nav2 has seven to ten lifecycle
nodes.
"""


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
    total: int = field(metadata=SAID)
    settled: bool = field(metadata=SAID)
    note: str = field(metadata=IF_ANY)

    def summary(self) -> str:
        """Return the result in one line."""
        return f"{counted_of(len(self.services), self.total, 'service')}. {self.note}".rstrip()


async def list_services(robot: Robot, pattern: str = "", include_hidden: bool = False, limit: int = 200) -> ServiceList:
    """Return the services whose names or types match. Services that every node has come last, and only with a pattern
    or `include_hidden`; services of actions only with `include_hidden`.
    """
    found, absence = await asyncio.gather(robot.graph.services(), robot.graph.absence())
    types = {row.name: row.types for row in found}
    matching = names.matching(sorted(types), pattern, types.__getitem__)
    matching.sort(key=lambda name: is_infrastructure(name, types[name]))  # a limit omits infrastructure first

    lifecycle = {name for name in matching if any(kind.startswith("lifecycle_msgs/") for kind in types[name])}
    folds = len(lifecycle) > _FEW_LIFECYCLE  # ros2_lifecycle_state and ros2_lifecycle_change are for these

    def is_meant(name: str) -> bool:
        if include_hidden or pattern:
            return include_hidden or not names.is_hidden(name)
        return not (is_infrastructure(name, types[name]) or (folds and name in lifecycle))

    visible = [name for name in matching if is_meant(name)]
    chosen = [(name, types[name][0]) for name in visible[:limit]]
    providers, (fields, unknown) = await asyncio.gather(
        _providers(robot), robot.values.fields_of((kind for _, kind in chosen), "_Request")
    )
    entries = [ServiceEntry(name, kind, fields[kind], providers.get(name, [])) for name, kind in chosen]
    note, left_out = "", len(matching) - len(visible)
    if left_out and pattern:
        note = f"Not shown: {left_out} services of actions; include_hidden=true lists them. "
    elif left_out:
        note = f"Not shown: {left_out} standard services of nodes and actions; include_hidden=true lists them. "
    note += list_note(len(visible), limit, found.settled, absence)
    return ServiceList(entries, len(types), found.settled, " ".join(filter(None, (note.rstrip(), unknown))))


async def _providers(robot: Robot) -> dict[str, list[str]]:
    """Return service → the full names of the nodes that serve it. ROS 2 reports this only node by node."""

    async def served_by(node: str) -> list[str]:
        try:
            return [entry.name for entry in (await robot.graph.node(node)).servers]
        except (NotFound, BadName):  # the node has left meanwhile, or the middleware has no name for it
            return []

    nodes = [row.name for row in await robot.graph.nodes()]
    providers: dict[str, list[str]] = {}
    for node, services in zip(nodes, await asyncio.gather(*(served_by(node) for node in nodes)), strict=True):
        for service in services:
            providers.setdefault(service, []).append(node)
    return providers
