"""Resolve types: of a topic, service or action, from the requested type and the graph."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from time import monotonic
from typing import TYPE_CHECKING

from ros2_mcp.model import names, qos
from ros2_mcp.model.errors import NotFound, TypeConflict, UnknownInterface
from ros2_mcp.model.graph import TopicEndpoints
from ros2_mcp.model.qos import Choice
from ros2_mcp.model.text import named, quoted

if TYPE_CHECKING:
    from ros2_mcp.robot.graph import Graph

INFRASTRUCTURE = ("rcl_interfaces/srv/", "type_description_interfaces/srv/")
"""Prefixes of the types of services that every node has."""
_SEND_GOAL = "/_action/send_goal"
_LISTED = "ros2_interface_list shows what is there."
_MOST_TOLD = 6
"""The most endpoints that the error for a topic with several types names."""
_SEEN_S = 1.0
"""The time for which a topic's endpoints are assumed unchanged after a message was sent, in s: a fast publisher then
queries the graph once instead of before each message. A subscriber that appears meanwhile may miss one message. Not
measured."""
_MOST_SEEN = 256
"""The most topics whose endpoints are remembered: more than are published on at a time."""
_APPEARING_S = 1.0
"""The time limit for a topic to appear when a publication gives no type, in s; discovery on one machine takes less."""


@dataclass(frozen=True, slots=True)
class Destination:
    """A topic to publish on: absolute name, full type, and the QoS that reaches its subscribers."""

    topic: str
    type: str
    choice: Choice


@dataclass(slots=True)
class _Seen:
    """A destination found in the graph.

    `endpoints` are the topic's numbers of publishers and subscribers when the last message was sent; `until` is when
    the destination has to be looked up again (monotonic, in s).
    """

    destination: Destination
    endpoints: tuple[int, int] | None = None
    until: float = 0.0


class Types:
    """The types of topics, services and actions. Raises `TypeConflict` and `NotFound` with a hint."""

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self._only_type: dict[str, str] = {}
        self._seen: dict[tuple[str, str], _Seen] = {}

    async def full_name(self, requested: str, kind: str = "", in_use: Collection[str] = ()) -> str:
        """Return the full name of a type: `Twist` and `geometry_msgs/Twist` become `geometry_msgs/msg/Twist`.

        Args:
            requested: a full name, a name without its kind, or the last part alone. Short names are looked up in the
                types `in_use`, and then in all types that are installed where the bridge runs.
            kind: `msg`, `srv` or `action`; "" is any, in this order.
            in_use: the types that the topic, service or action has.

        Raises:
            BadName: if the name is not that of a type, or of another kind.
            TypeConflict: if several types have this name; the error names them.
            UnknownInterface: if no type has this name.
        """
        text = requested.strip()
        if kind and not names.is_short(text):
            return names.interface_type(text, kind)
        if text.count("/") == 2:
            return names.interface_type(text, text.split("/")[1])
        used = [name for name in in_use if names.is_type(text, name)]
        installed = used or await self._graph.interfaces()
        if not (used or any(names.is_type(text, name) for name in installed)):  # nodes may describe others
            installed = [*installed, *{name for row in await self._graph.topics() for name in row.types}]
        if names.is_short(text):
            found = [name for name in installed if names.is_type(text, name) and f"/{kind}" in name]
        else:  # std_srvs/SetBool
            candidates = [names.interface_type(text, each) for each in names.KINDS]
            found = [name for name in candidates if name in installed][:1]
        if len(found) > 1:
            raise TypeConflict(f"{text} may be {' or '.join(map(named, found))}.", "Give the full name.")
        if found:
            return found[0]
        raise UnknownInterface(
            f"No {kind or 'type'} called {quoted(text)} is installed where the bridge runs.",
            _like(text, installed, kind),
        )

    # ── topics ─────────────────────────────────────────────────────────────────────────────────────────────────

    async def topic(self, present: TopicEndpoints, requested: str = "") -> str:
        """Return the type of a topic with these endpoints; the requested one if the topic has none yet."""
        if requested and not names.is_derived(requested):
            requested = await self.full_name(requested, "msg", present.types)
        if not (requested or present.types):
            raise await self._graph.no_such_topic(present.topic)
        if requested or len(present.types) < 2:
            return _one_of(present.types, requested, present.topic)
        raise TypeConflict(
            f"{present.topic} has {len(present.types)} types: {', '.join(map(named, present.types))}.",
            f"{_who_has_which(present)}End the node that should not be there, or give the type: ros2_topic_subscribe "
            "takes msg_type.",
        )

    async def destination(self, topic: str, requested: str = "") -> Destination:
        """Return where to publish a message for this topic; raises `NotFound` if it has no type and none is
        requested.
        """
        topic = names.absolute(topic)
        seen = self._seen.get((topic, requested))
        if seen and monotonic() < seen.until:
            return seen.destination
        present = await self._graph.endpoints(topic)
        if not (requested or present.types):
            present = await self._graph.wait_for(topic, subscribers=1, timeout_s=_APPEARING_S)
        type_name = await self.topic(present, requested)
        subscribers = [subscriber for subscriber in present.subscribers if subscriber.type == type_name]
        found = Destination(topic, type_name, qos.for_publishing(subscribers))
        self._seen[topic, requested] = _Seen(found, seen.endpoints if seen else None)
        if len(self._seen) > _MOST_SEEN:
            del self._seen[next(iter(self._seen))]
        return found

    def note_sent(self, destination: Destination, requested: str, endpoints: tuple[int, int] | None) -> None:
        """Record how many endpoints a topic had when a message to this destination was sent.

        If the numbers are those of the message before, the destination is reused for a second.
        """
        seen = self._seen.get((destination.topic, requested))
        if not seen or seen.destination is not destination:
            return
        seen.until = monotonic() + _SEEN_S if endpoints is not None and endpoints == seen.endpoints else 0.0
        seen.endpoints = endpoints

    # ── services ───────────────────────────────────────────────────────────────────────────────────────────────

    async def service(self, service: str, requested: str = "") -> str:
        """Return the type to call a service with; the requested one if its server is not in the graph yet.

        If the service had only the requested type at its last call, this needs no round trip.
        """
        if requested and self._only_type.get(service) == requested:
            return requested
        found = await self._graph.services()
        types = next((row.types for row in found if row.name == service), ())
        if requested and not ("/action/" in requested and names.is_derived(requested)):
            requested = await self.full_name(requested, "srv", types)
        if not (types or requested):
            raise await self.no_such_service(service)
        if len(types) == 1 and requested in ("", *types):
            self._only_type[service] = types[0]
        return _one_of(types, requested, service)

    async def absent_service(self, service: str) -> NotFound | None:
        """Return an error if a service does not exist although discovery has settled; None if it exists or may
        exist.
        """
        if service in self._only_type:
            return None
        found = await self._graph.services()
        is_there = not found.settled or any(row.name == service for row in found)
        return None if is_there else await self.no_such_service(service)

    async def no_such_service(self, service: str) -> NotFound:
        """Return the error for a service that does not exist, with the nearest name."""
        return NotFound(f"There is no service {service}.", await self.near_service(service))

    async def near_service(self, service: str) -> str:
        """Return a hint for a service that does not exist: the service that was most likely meant."""
        others = [row for row in await self._graph.services() if row.name != service]
        likely = [row.name for row in others if not is_infrastructure(row.name, row.types)]
        return await self._graph.near(service, likely, "ros2_service_list")

    def forget_service(self, service: str) -> None:
        """Forget the type of a service whose server has gone: it may return with another type."""
        self._only_type.pop(service, None)

    # ── actions ────────────────────────────────────────────────────────────────────────────────────────────────

    async def actions(self) -> dict[str, Sequence[str]]:
        """Return the types of every action with a server or a client in the graph, by name."""
        return {
            row.name.removesuffix(_SEND_GOAL): [kind.removesuffix("_SendGoal") for kind in row.types]
            for row in await self._graph.services()
            if row.name.endswith(_SEND_GOAL)
        }

    async def action(self, action: str, requested: str = "") -> str:
        """Return the type of an action, which must exist."""
        present = await self.actions()
        types = present.get(action, ())
        requested = await self.full_name(requested, "action", types) if requested else ""
        if not types:
            raise NotFound(f"There is no action {action}: no server offers it.", await self.near_action(action))
        return _one_of(types, requested, action)

    async def near_action(self, action: str) -> str:
        """Return a hint for an action that does not exist: the action that was most likely meant."""
        return await self._graph.near(action, list(await self.actions()), "ros2_list_actions")


def _like(text: str, installed: Sequence[str], kind: str) -> str:
    """Return a hint for a type that does not exist: the most similar type, of that kind first."""
    if not names.is_short(text):
        return names.did_you_mean(names.interface_type(text, "msg"), installed, _LISTED)
    of_kind = {name.rpartition("/")[2]: name for name in installed if f"/{kind}" in name}
    near = of_kind.get(names.nearest(text, list(of_kind)))
    others = [name for name in installed if names.is_type(text, name)]
    if others:
        return f"There is {' and '.join(map(named, others))}, which is no {kind}."
    return f"Did you mean {named(near)}?" if near else _LISTED


def _who_has_which(present: TopicEndpoints) -> str:
    """Return a sentence with each publisher and subscriber and its type."""
    told = [f"{named(each.node)} publishes {named(each.type)}" for each in present.publishers]
    told += [f"{named(each.node)} subscribes to {named(each.type)}" for each in present.subscribers]
    more = f", and {len(told) - _MOST_TOLD} more" if len(told) > _MOST_TOLD else ""
    return f"{', '.join(told[:_MOST_TOLD])}{more}. "


def _one_of(types: Collection[str], requested: str, name: str) -> str:
    """Return the requested type if it is in use or no type is yet, or the only type if none is requested.

    Raises:
        TypeConflict: if the requested type is not in use, or several types are and none is requested.
    """
    if requested and types and requested not in types:
        raise TypeConflict(
            f"{name} has the type {' and '.join(map(named, types))}, not {requested}.",
            "Leave the type out to use the one it has.",
        )
    if not requested and len(types) > 1:
        raise TypeConflict(f"{name} has {len(types)} types: {', '.join(map(named, types))}.", "Give the type you mean.")
    return requested or next(iter(types))


def is_infrastructure(name: str, types: Sequence[str]) -> bool:
    """Return whether every node has such a service (parameters, type descriptions), or it is part of an action."""
    return names.is_hidden(name) or any(kind.startswith(INFRASTRUCTURE) for kind in types)
