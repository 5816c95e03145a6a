"""Which type a name has: the asked one, or the only one that the graph knows."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ros2_mcp.model import names, qos
from ros2_mcp.model.errors import NotFound, TypeConflict
from ros2_mcp.model.graph import TopicEndpoints
from ros2_mcp.model.qos import Choice

if TYPE_CHECKING:
    from ros2_mcp.robot.graph import Graph

INFRASTRUCTURE = ("rcl_interfaces/srv/", "type_description_interfaces/srv/")
"""Types of services that every node has."""
_SEND_GOAL = "/_action/send_goal"
_APPEARING_S = 1.0
"""How long a publication without a type waits for a topic that is just coming up; on one machine it takes less."""


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

    async def topic(self, present: TopicEndpoints, asked: str = "") -> str:
        """The type of a topic with these endpoints; the asked one where it has none yet."""
        if asked and not names.is_derived(asked):
            asked = names.interface_type(asked, "msg")
        if not (asked or present.types):
            raise await self._graph.no_such_topic(present.topic)
        return asked if not present.types else _one_of(present.types, asked, present.topic)

    async def destination(self, topic: str, asked: str = "") -> Destination:
        """Where a message for this topic goes; raises `NotFound` if it has no type and none is asked for."""
        topic = names.absolute(topic)
        present = await self._graph.endpoints(topic)
        if not (asked or present.types):
            present = await self._graph.wait_for(topic, subscribers=1, timeout_s=_APPEARING_S)
        type_name = await self.topic(present, asked)
        subscribers = [subscriber for subscriber in present.subscribers if subscriber.type == type_name]
        return Destination(topic, type_name, qos.for_publishing(subscribers))

    # ── services ───────────────────────────────────────────────────────────────────────────────────────────────

    async def service(self, service: str, asked: str = "") -> str:
        """The type to call a service with; the asked one where its server is not there yet.

        Of a service that had only the asked type when it was looked at last, the graph is not asked again.
        """
        if asked and self._only_type.get(service) == asked:
            return asked
        is_of_action = "/action/" in asked and names.is_derived(asked)
        asked = asked if is_of_action or not asked else names.interface_type(asked, "srv")
        found = await self._graph.services()
        types = next((row.types for row in found if row.name == service), ())
        if not (types or asked):
            raise NotFound(f"There is no service {service}.", await self.near_service(service))
        if len(types) == 1 and asked in ("", *types):
            self._only_type[service] = types[0]
        return asked if not types else _one_of(types, asked, service)

    async def near_service(self, service: str) -> str:
        """A hint for a service that is not there: the one that was most likely meant."""
        others = [row for row in await self._graph.services() if row.name != service]
        known = [row.name for row in others if not is_infrastructure(row.name, row.types)]
        return names.did_you_mean(service, known, "ros2_service_list shows what is there.")

    def forget_service(self, service: str) -> None:
        """Its server has gone: it may come back with another type."""
        self._only_type.pop(service, None)

    # ── actions ────────────────────────────────────────────────────────────────────────────────────────────────

    async def actions(self) -> dict[str, Sequence[str]]:
        """Action → its types, of every action with a server or a client in the graph."""
        return {
            row.name.removesuffix(_SEND_GOAL): [kind.removesuffix("_SendGoal") for kind in row.types]
            for row in await self._graph.services()
            if row.name.endswith(_SEND_GOAL)
        }

    async def action(self, action: str, asked: str = "") -> str:
        """The type of an action, which must be there."""
        known = await self.actions()
        asked = names.interface_type(asked, "action") if asked else ""
        if action not in known:
            hint = names.did_you_mean(action, list(known), "ros2_list_actions shows what is there.")
            raise NotFound(f"There is no action {action}: no server offers it.", hint)
        return _one_of(known[action], asked, action)


def _one_of(types: Collection[str], asked: str, name: str) -> str:
    if asked and asked not in types:
        raise TypeConflict(
            f"{name} has the type {' and '.join(types)}, not {asked}.", "Leave the type out to use the one it has."
        )
    if not asked and len(types) > 1:
        raise TypeConflict(f"{name} has {len(types)} types: {', '.join(types)}.", "Give the type you mean.")
    return asked or next(iter(types))


def is_infrastructure(name: str, types: Sequence[str]) -> bool:
    """Whether a service is one that nodes have of themselves: for parameters, type descriptions, parts of actions."""
    return names.is_hidden(name) or any(kind.startswith(INFRASTRUCTURE) for kind in types)
