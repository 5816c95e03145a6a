"""Which type a name has: the requested one, or the only one in the graph."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ros2_mcp.model import names, qos
from ros2_mcp.model.errors import NotFound, TypeConflict
from ros2_mcp.model.graph import TopicEndpoints
from ros2_mcp.model.qos import Choice
from ros2_mcp.model.text import named

if TYPE_CHECKING:
    from ros2_mcp.robot.graph import Graph

INFRASTRUCTURE = ("rcl_interfaces/srv/", "type_description_interfaces/srv/")
"""Types of services that every node has."""
_SEND_GOAL = "/_action/send_goal"
_APPEARING_S = 1.0
"""How long a publication without a type waits for a topic that is coming up; discovery on one machine takes less."""


@dataclass(frozen=True, slots=True)
class Destination:
    """A topic to publish on: its absolute name, full type, and the QoS that reaches its subscribers."""

    topic: str
    type: str
    choice: Choice


class Types:
    """The types of topics, services and actions. Raises `TypeConflict` and `NotFound` with the way out."""

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self._only_type: dict[str, str] = {}

    # ── topics ─────────────────────────────────────────────────────────────────────────────────────────────────

    async def topic(self, present: TopicEndpoints, requested: str = "") -> str:
        """The type of a topic with these endpoints; the requested one where it has none yet."""
        if requested and not names.is_derived(requested):
            requested = names.interface_type(requested, "msg")
        if not (requested or present.types):
            raise await self._graph.no_such_topic(present.topic)
        return _one_of(present.types, requested, present.topic)

    async def destination(self, topic: str, requested: str = "") -> Destination:
        """Where a message for this topic goes; raises `NotFound` if it has no type and none is requested."""
        topic = names.absolute(topic)
        present = await self._graph.endpoints(topic)
        if not (requested or present.types):
            present = await self._graph.wait_for(topic, subscribers=1, timeout_s=_APPEARING_S)
        type_name = await self.topic(present, requested)
        subscribers = [subscriber for subscriber in present.subscribers if subscriber.type == type_name]
        return Destination(topic, type_name, qos.for_publishing(subscribers))

    # ── services ───────────────────────────────────────────────────────────────────────────────────────────────

    async def service(self, service: str, requested: str = "") -> str:
        """The type to call a service with; the requested one where its server is not in the graph yet.

        A service that had the requested type and no other at its last call costs no round trip.
        """
        if requested and self._only_type.get(service) == requested:
            return requested
        if requested and not ("/action/" in requested and names.is_derived(requested)):
            requested = names.interface_type(requested, "srv")
        found = await self._graph.services()
        types = next((row.types for row in found if row.name == service), ())
        if not (types or requested):
            raise NotFound(f"There is no service {service}.", await self.near_service(service))
        if len(types) == 1 and requested in ("", *types):
            self._only_type[service] = types[0]
        return _one_of(types, requested, service)

    async def near_service(self, service: str) -> str:
        """A hint for a service that is not there: the one that was most likely meant."""
        others = [row for row in await self._graph.services() if row.name != service]
        likely = [row.name for row in others if not is_infrastructure(row.name, row.types)]
        return names.did_you_mean(service, likely, "ros2_service_list shows what is there.")

    def forget_service(self, service: str) -> None:
        """Forgets the type of a service whose server has gone: it may come back with another one."""
        self._only_type.pop(service, None)

    # ── actions ────────────────────────────────────────────────────────────────────────────────────────────────

    async def actions(self) -> dict[str, Sequence[str]]:
        """Action → its types, of every action with a server or a client in the graph."""
        return {
            row.name.removesuffix(_SEND_GOAL): [kind.removesuffix("_SendGoal") for kind in row.types]
            for row in await self._graph.services()
            if row.name.endswith(_SEND_GOAL)
        }

    async def action(self, action: str, requested: str = "") -> str:
        """The type of an action, which must be there."""
        present = await self.actions()
        requested = names.interface_type(requested, "action") if requested else ""
        if action not in present:
            hint = names.did_you_mean(action, list(present), "ros2_list_actions shows what is there.")
            raise NotFound(f"There is no action {action}: no server offers it.", hint)
        return _one_of(present[action], requested, action)


def _one_of(types: Collection[str], requested: str, name: str) -> str:
    """The requested type of those in use; any where there is none yet, the only one where none is requested."""
    if requested and types and requested not in types:
        raise TypeConflict(
            f"{name} has the type {' and '.join(map(named, types))}, not {requested}.",
            "Leave the type out to use the one it has.",
        )
    if not requested and len(types) > 1:
        raise TypeConflict(f"{name} has {len(types)} types: {', '.join(map(named, types))}.", "Give the type you mean.")
    return requested or next(iter(types))


def is_infrastructure(name: str, types: Sequence[str]) -> bool:
    """Whether every node has such a service (parameters, type descriptions), or it is a part of an action."""
    return names.is_hidden(name) or any(kind.startswith(INFRASTRUCTURE) for kind in types)
