"""Questions to the robot's graph, and the mapping of the bridge's refusals to this package's errors."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING, Any

from ros2_mcp.model import names
from ros2_mcp.model.errors import (
    BridgeRefused,
    LinkError,
    NotFound,
    RobotError,
    TimedOut,
    UnknownInterface,
)
from ros2_mcp.model.graph import (
    BridgeStatus,
    NamedTypes,
    NodeEndpoints,
    NodeRow,
    RelayCounts,
    Rows,
    ServiceRow,
    TopicEndpoints,
    TopicRow,
    endpoints_from,
)

if TYPE_CHECKING:
    from ros2_mcp.link.client import Bridge, Reply

SETTLE_S = 4.0
"""A little longer than the 3.5 s after which the bridge is sure that nobody else is there (its `graph.py`)."""
REQUEST_S = 10.0
"""For what the bridge answers from memory: only one that hangs takes so long, and it is declared dead before."""
_SETTLING = 0.8
"""The part of a bounded wait that discovery may take; then what is known so far is told."""
_KINDS: Mapping[str, type[RobotError]] = {
    "unknown_type": UnknownInterface,
    "not_found": NotFound,
    "timeout": TimedOut,
    "server_gone": NotFound,
}


class Graph:
    """The graph as the bridge sees it."""

    def __init__(self, bridge: Bridge) -> None:
        self._bridge = bridge

    @property
    def is_closed(self) -> bool:
        """Whether the link to the robot was closed by us."""
        return self._bridge.is_closed

    async def ask(self, op: str, body: bytes = b"", *, timeout_s: float = REQUEST_S, **arguments: Any) -> Reply:
        """One request to the bridge, with its refusals mapped to this package's errors."""
        try:
            return await self._bridge.request(op, body, timeout_s=timeout_s, **arguments)
        except BridgeRefused as refused:
            raise _KINDS.get(refused.kind, LinkError)(refused.message, refused.hint) from refused

    async def query(self, op: str, within_s: float | None = None, **arguments: Any) -> Mapping[str, Any]:
        """One query of the graph, after discovery has settled; or within a time, with what is known by then."""
        if within_s is None:
            return (await self.ask(op, settle_s=SETTLE_S, timeout_s=REQUEST_S + SETTLE_S, **arguments)).ok
        return (await self.ask(op, settle_s=_SETTLING * within_s, timeout_s=within_s, **arguments)).ok

    async def topics(self, within_s: float | None = None) -> Rows[TopicRow]:
        """Every topic."""
        raw = await self.query("topics", within_s)
        return Rows([TopicRow(*row) for row in raw["topics"]], raw["settled"])

    async def services(self, within_s: float | None = None) -> Rows[ServiceRow]:
        """Every service."""
        raw = await self.query("services", within_s)
        return Rows([ServiceRow(*row) for row in raw["services"]], raw["settled"])

    async def nodes(self, within_s: float | None = None) -> Rows[NodeRow]:
        """Every node, ours among them."""
        raw = await self.query("nodes", within_s)
        return Rows([NodeRow(names.full_node_name(*row)) for row in raw["nodes"]], raw["settled"])

    async def node(self, node: str) -> NodeEndpoints:
        """What one node uses and offers; raises `NotFound` if it is not there."""
        name, namespace = names.node_name(node)
        raw = await self.query("node", name=name, namespace=namespace)
        kinds = ("publishers", "subscribers", "servers", "clients")
        return NodeEndpoints(*([NamedTypes(*row) for row in raw[kind]] for kind in kinds))

    async def interfaces(self, within_s: float = REQUEST_S) -> list[str]:
        """The full names of every message, service and action that is installed where the bridge runs, sorted."""
        return sorted((await self.ask("interfaces", timeout_s=within_s)).ok["interfaces"])

    async def relays(self) -> Mapping[str, RelayCounts]:
        """What became of the messages of every relay that runs in the bridge, by the names of the relays."""
        raw = (await self.ask("relays")).ok["relays"]
        return {name: RelayCounts(**counts) for name, counts in raw.items()}

    async def bridge_status(self) -> BridgeStatus:
        """How the bridge is."""
        stats = (await self.ask("stats")).ok
        hello = self._bridge.hello
        assert hello is not None  # it has just answered
        return BridgeStatus(
            python=hello.python,
            distro=hello.distro,
            rmw=hello.rmw,
            domain_id=hello.domain_id,
            node=hello.node,
            pid=hello.pid,
            executor=hello.executor,
            starts=self._bridge.generation,
            restarts=list(self._bridge.restarts),
            found=self._bridge.origin,
            uptime_s=float(stats["uptime_s"]),
            memory_bytes=stats["rss_bytes"],
            subscriptions=stats["subscriptions"],
            publishers=stats["publishers"],
            clients=stats["clients"],
        )

    @property
    def own_nodes(self) -> Collection[str]:
        """The full names of the nodes of our bridge, and of lost ones: the graph shows those for some seconds more."""
        return self._bridge.nodes

    @property
    def domain_id(self) -> int | None:
        """The ROS domain; None until there is a bridge."""
        return self._bridge.hello.domain_id if self._bridge.hello else None

    async def ready(self) -> None:
        """Waits until there is a bridge; raises `LinkError` with the reason where there can be none."""
        await self._bridge.ready()

    async def endpoints(self, topic: str) -> TopicEndpoints:
        """The publishers and subscribers of a topic; empty where the graph does not know it."""
        return endpoints_from(topic, await self.query("endpoints", topic=topic))

    async def wait_for(
        self,
        topic: str,
        *,
        publishers: int = 0,
        subscribers: int = 0,
        timeout_s: float,
        present: TopicEndpoints | None = None,
    ) -> TopicEndpoints:
        """The endpoints of a topic as soon as it has that many; what there is when the time is over.

        Whoever has just asked who is `present` need not ask again.
        """
        present = present or await self.endpoints(topic)
        if len(present.publishers) >= publishers and len(present.subscribers) >= subscribers:
            return present
        try:
            reply = await self.ask(
                "wait_endpoints",
                topic=topic,
                publishers=publishers,
                subscribers=subscribers,
                timeout_s=timeout_s,
            )
        except TimedOut:
            return await self.endpoints(topic)
        return endpoints_from(topic, reply.ok)

    async def no_such_topic(self, topic: str) -> NotFound:
        """The error for a topic that is not there, or not seen yet, with the nearest right spelling."""
        found = await self.topics()
        if not found.settled:
            return NotFound(f"{topic} is not seen yet, but discovery is still under way.", "Ask again in a moment.")
        known = [row.name for row in found]
        return NotFound(
            f"There is no topic {topic}: nobody publishes or subscribes to it.",
            names.did_you_mean(topic, known, "ros2_topic_list shows what is there."),
        )
