"""Queries about the robot's graph, and the mapping of the bridge's errors to this package's errors."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeVar, cast

from ros2_mcp.model import names
from ros2_mcp.model.errors import (
    BridgeRefused,
    Lapsed,
    Latched,
    LinkError,
    NotFound,
    Refused,
    RobotError,
    Stopped,
    TimedOut,
    UnknownInterface,
)
from ros2_mcp.model.graph import (
    OF_EVERY_NODE,
    BridgeStatus,
    Contact,
    NamedTypes,
    NodeEndpoints,
    NodeRow,
    RelayCounts,
    Rows,
    ServiceRow,
    TopicEndpoints,
    TopicRow,
)
from ros2_mcp.model.qos import Endpoint
from ros2_mcp.model.times import Outage
from ros2_mcp.robot.seen import Seen, is_of_robot
from ros2_mcp_common.wire import protocol

if TYPE_CHECKING:
    from ros2_mcp.link.client import Bridge, Posted, Reply

SETTLE_S = 4.0
"""The time limit for discovery to settle before a query, in s: slightly longer than the 3.5 s after which the bridge
considers discovery complete (its `graph.py`)."""
REQUEST_S = 10.0
"""The time limit for a reply that the bridge gives from memory, in s. Only a hung bridge takes that long, and it is
given up earlier."""
NO_END_S = 1e9
"""32 years, in s: the time-out of requests that stay open, such as fail-safes and relays. Every request on the stream
needs a time-out."""
_COUNTED_AT_ONCE = 200
"""The most topics whose endpoints the bridge counts at once, which takes 2 ms in a graph of 2,000 topics: a stop can
pass between two such requests."""
_ASKED_AT_ONCE = 32
"""The most concurrent requests about nodes; the bridge answers one after the other."""
_SETTLING = 0.8
"""The share of a bounded wait that discovery may use; the rest is for the reply."""
_KINDS: Mapping[str, type[RobotError]] = {
    "unknown_type": UnknownInterface,
    "not_found": NotFound,
    "timeout": TimedOut,
    "server_gone": NotFound,
    "stopped": Stopped,
    "lapsed": Lapsed,
    "refused": Refused,
}
_NOTHING_SENT: Collection[str] = (
    "bad_request", "unknown_type", "not_found", "stopped", "lapsed", "latched", "refused",
)  # fmt: skip
"""Kinds of errors by which the bridge reports that it sent nothing."""
_Shape = TypeVar("_Shape")


class Graph:
    """The ROS graph as the bridge sees it."""

    def __init__(self, bridge: Bridge) -> None:
        self._bridge = bridge
        self.seen = Seen()
        self._looking = asyncio.Semaphore(_ASKED_AT_ONCE)

    @property
    def is_closed(self) -> bool:
        """Whether this server has closed the link to the robot."""
        return self._bridge.is_closed

    async def ask(self, op: str, body: bytes = b"", *, timeout_s: float = REQUEST_S, **arguments: Any) -> Reply:
        """Send a request to the bridge, and return the reply. The bridge's errors are raised as this package's
        errors.
        """
        return await self.reply_to(self._bridge.request(op, body, timeout_s=timeout_s, **arguments))

    def post(self, op: str, body: bytes = b"", **arguments: Any) -> Posted:
        """Write a request now, before everything that is sent later. `reply_to` awaits its reply."""
        return self._bridge.post(op, body, **arguments)

    async def reply_to(self, request: Awaitable[Reply]) -> Reply:
        """Await the reply to a request. The bridge's errors are raised as this package's errors."""
        try:
            return await request
        except BridgeRefused as refused:
            if refused.kind == "latched":  # the bridge's event with the originator came before this reply
                raise Latched(refused.message, refused.hint, by=self.latched_by) from refused
            raise _KINDS.get(refused.kind, LinkError)(refused.message, refused.hint) from refused

    async def query(
        self,
        shape: type[_Shape],  # noqa: ARG002 - for the type checker
        op: str,
        body: bytes = b"",
        *,
        timeout_s: float = REQUEST_S,
        **arguments: Any,
    ) -> _Shape:
        """Return the `ok` part of one reply, with the shape that `protocol.OPERATIONS` gives it. Raises as `ask`."""
        reply = await self.ask(op, body, timeout_s=timeout_s, **arguments)
        return cast("_Shape", reply.ok)  # server and bridge have the same release: the shape needs no check

    async def _settled(self, shape: type[_Shape], op: str, within_s: float | None = None, **arguments: Any) -> _Shape:
        """Query once discovery has settled; with a time limit, answer with the present state of the graph when it is
        nearly over.
        """
        if within_s is None:
            return await self.query(shape, op, timeout_s=REQUEST_S + SETTLE_S, settle_s=SETTLE_S, **arguments)
        return await self.query(shape, op, timeout_s=within_s, settle_s=_SETTLING * within_s, **arguments)

    async def topics(self, within_s: float | None = None) -> Rows[TopicRow]:
        """Return every topic."""
        reply = await self._settled(protocol.TopicsReply, "topics", within_s)
        return Rows([TopicRow(*row) for row in reply["topics"]], reply["settled"])

    async def topics_and_absence(self, count_most: int) -> tuple[Rows[TopicRow], str]:
        """Return every topic, and the result of `absence`, in one round trip.

        With more topics than `count_most`, or than are counted at once, their publishers and subscribers are not
        counted; `counted` does so for the topics that are shown.
        """
        reply = await self._settled(protocol.TopicsReply, "topics", count_most=min(count_most, _COUNTED_AT_ONCE))
        topics = Rows([TopicRow(*row) for row in reply["topics"]], reply["settled"])
        return topics, await self.absence(found=_nodes(reply["nodes"], settled=reply["settled"]))

    async def counted(self, rows: Sequence[TopicRow]) -> Sequence[TopicRow]:
        """Return these rows with their numbers of publishers and subscribers."""
        if all(row.publishers != protocol.NOT_COUNTED for row in rows):
            return rows
        reply = await self.query(protocol.CountedReply, "counted", topics=[row.name for row in rows])
        return [TopicRow(row.name, row.types, *counts) for row, counts in zip(rows, reply["counted"], strict=True)]

    async def services(self, within_s: float | None = None) -> Rows[ServiceRow]:
        """Return every service."""
        reply = await self._settled(protocol.ServicesReply, "services", within_s)
        return Rows([ServiceRow(*row) for row in reply["services"]], reply["settled"])

    async def servers(self, service: str) -> list[str]:
        """Return the full names of the nodes that provide a service; a name appears twice if two nodes share it."""
        reply = await self._settled(protocol.ServersReply, "servers", service=service)
        return [row.name for row in _nodes(reply["servers"], settled=True)]

    async def nodes(self, within_s: float | None = None) -> Rows[NodeRow]:
        """Return every node, including the nodes of this server."""
        reply = await self._settled(protocol.NodesReply, "nodes", within_s)
        return _nodes(reply["nodes"], settled=reply["settled"])

    async def node(self, node: str) -> NodeEndpoints:
        """Return the endpoints of one node; raises `NotFound` if the node does not exist."""
        name, namespace = names.node_name(node)
        reply = await self._settled(protocol.NodeReply, "node", name=name, namespace=namespace)
        sides = (reply["publishers"], reply["subscribers"], reply["servers"], reply["clients"])
        return NodeEndpoints(*([NamedTypes(*row) for row in side] for side in sides))

    async def interfaces(self, within_s: float = REQUEST_S) -> list[str]:
        """Return the full names of all interfaces that are installed where the bridge runs, sorted."""
        return sorted((await self.query(protocol.InterfacesReply, "interfaces", timeout_s=within_s))["interfaces"])

    async def relays(self) -> Mapping[str, RelayCounts]:
        """Return the counts of every relay that runs in the bridge, by name of the relay."""
        reply = await self.query(protocol.RelaysReply, "relays")
        return {name: RelayCounts(**counts) for name, counts in reply["relays"].items()}

    def relay_ended(self, name: str) -> RelayCounts | None:
        """Return the last counts of a relay whose request was cancelled; None until the bridge has reported them."""
        counts = self._bridge.relays_ended.get(name)
        return RelayCounts(**counts) if counts else None

    def repeat_begun_at(self, name: str) -> float | None:
        """Return when the event arrived that a repeat's first message was sent (monotonic, in s); None before."""
        return self._bridge.repeats_begun.get(name)

    def motion_report(self, name: str) -> Mapping[str, Any]:
        """Return the last report of a running motion; empty before the first."""
        return self._bridge.motions.get(name, {})

    @property
    def was_reached(self) -> bool:
        """Whether any bridge has ever connected: before that, this server cannot have moved anything there."""
        return bool(self._bridge.nodes)

    @property
    def is_connected(self) -> bool:
        """Whether a bridge is connected now."""
        return self._bridge.hello is not None

    @property
    def silent_s(self) -> float:
        """The time since the bridge's last message, in s; infinite while there is no bridge."""
        return self._bridge.silent_s

    @property
    def unheard_s(self) -> float:
        """The time since the last message of any bridge of this robot, in s; infinite before the first."""
        return self._bridge.unheard_s

    @property
    def failure(self) -> str:
        """The reason why the last attempt to reach the robot failed; "" once an attempt succeeded."""
        return self._bridge.failure

    @property
    def bridge_age_s(self) -> float:
        """The age of the present connection to a bridge, in s; 0 while there is none."""
        return self._bridge.age_s

    async def contact(self) -> Contact:
        """Return distribution, middleware, domain and clock of the bridge, which is started if necessary. Raises as
        `ask`.
        """
        hello, clock = await self._bridge.ready(), self._bridge.clock
        offset_s = clock.offset_ns / 1e9 if clock.is_known else None
        return Contact(hello.distro, hello.rmw, hello.domain_id, offset_s, clock.rtt_s)

    async def bridge_status(self) -> BridgeStatus:
        """Return the state of the bridge process and its link."""
        stats = await self.query(protocol.StatsReply, "stats")
        hello = self._bridge.hello
        assert hello is not None  # it has just answered
        clock = self._bridge.clock
        return BridgeStatus(
            **hello._asdict(),
            starts=self._bridge.generation,
            restarts=list(self._bridge.restarts),
            found=self._bridge.origin,
            uptime_s=stats["uptime_s"],
            memory_bytes=stats["rss_bytes"],
            subscriptions=stats["subscriptions"],
            publishers=stats["publishers"],
            clients=stats["clients"],
            clock_offset_s=clock.offset_ns / 1e9 if clock.is_known else None,
            link_rtt_s=clock.rtt_s,
        )

    @property
    def is_remote(self) -> bool:
        """Whether a network lies between this server and the robot, so that large messages take time."""
        return self._bridge.is_remote

    @property
    def outages(self) -> Sequence[Outage]:
        """The times during which a remote robot was unreachable."""
        return self._bridge.outages

    async def absence(self, within_s: float | None = None, found: Rows[NodeRow] | None = None) -> str:
        """Return a sentence if no robot is present, with the domain and the earlier observations; "" if a robot is
        present.

        Servers like this one and the ROS command-line tools are not robots; a publisher without a node may be one. A
        caller that has just listed the nodes passes them as `found`.
        """
        found = await self.nodes(within_s) if found is None else found
        nodes = [row.name for row in found if is_of_robot(row.name)]
        await asyncio.gather(*(self._look_at(node) for node in nodes if not self.seen.knows(node)))
        if nodes or await self._has_other_publishers(within_s):
            return ""
        domain = "this domain" if self.domain_id is None else f"domain {self.domain_id}"
        if not found.settled:
            return f"No robot is seen in {domain} yet: discovery is still under way, ask again."
        left = str(self.seen.left((), {}))
        place = f"Is it on, in the same domain (ROS_DOMAIN_ID is {self.domain_id} here), and reachable from here?"
        if self._bridge.is_remote:
            place = (
                f"Are its nodes running there, and in {domain}? Choose another domain with --domain-id N, or with "
                "?domain_id=N at the end of its address."
            )
        return " ".join(filter(None, (f"No robot is seen in {domain}.", left, place)))

    async def _look_at(self, node: str) -> None:
        """Record a node that was not seen before, with the topics that it publishes."""
        async with self._looking:
            try:
                topics = {row.name: row.types[0] for row in (await self.node(node)).publishers if row.types}
            except RobotError:  # the node has gone meanwhile, or its name is invalid in ROS
                return
        self.seen.note(node, topics)

    async def _has_other_publishers(self, within_s: float | None) -> bool:
        """Return whether a publisher without a node exists, such as a flight controller."""
        topics = [row for row in await self.topics(within_s) if row.name not in OF_EVERY_NODE and row.publishers]
        for row in topics:
            if any(is_of_robot(one.node) for one in (await self.endpoints(row.name, within_s)).publishers):
                return True
        return False

    @property
    def own_nodes(self) -> Collection[str]:
        """The full names of the nodes of this server's bridges. The graph shows those of lost bridges for some seconds
        more.
        """
        return self._bridge.nodes

    def frame_id_of(self, topic: str) -> str:
        """Return the frame (`header.frame_id`) of the last velocity command on a topic; "" if unknown."""
        return self._bridge.frame_ids.get(topic, "")

    def note_frame_id(self, topic: str, frame_id: str) -> None:
        """Record the frame of a command that is about to be published; the bridge reports the frames of its own
        commands.
        """
        self._bridge.frame_ids[topic] = frame_id

    @property
    def losses(self) -> int:
        """The number of bridges that this server has lost so far."""
        return self._bridge.losses

    @property
    def last_loss(self) -> str:
        """The reason for the last loss of a bridge; "" if there was none."""
        return self._bridge.restarts[-1] if self._bridge.restarts else ""

    @property
    def lapses(self) -> Sequence[float]:
        """The durations of this server's silence at each lapse of the link lease, in s."""
        return self._bridge.lapses

    @property
    def lapsed_at(self) -> float:
        """The time of the report of the last lapse of the link lease (monotonic, in s); 0 if there was none."""
        return self._bridge.lapsed_at

    @property
    def latched_by(self) -> str:
        """The originator and the reason of the last setting of the latch that a bridge reported; "" if there
        was none.
        """
        return self._bridge.latched_by

    @property
    def latched_at(self) -> float:
        """The time of the report of the last setting of the latch (monotonic, in s)."""
        return self._bridge.latched_at

    @property
    def kept_out(self) -> str:
        """Why the bridge last ended what drove the robot towards a keep-out zone; "" if it never did."""
        return self._bridge.kept_out

    @property
    def kept_out_at(self) -> float:
        """The time of that report (monotonic, in s); 0 if there was none."""
        return self._bridge.kept_out_at

    @property
    def domain_id(self) -> int | None:
        """The ROS domain; None until there is a bridge."""
        return self._bridge.hello.domain_id if self._bridge.hello else None

    async def ready(self) -> None:
        """Wait until a bridge is connected; raises `LinkError` with the reason if that is impossible."""
        await self._bridge.ready()

    async def name_of(self, topic: str) -> str:
        """Return the full name of a topic; raises `BadName` for an invalid name."""
        return names.absolute(topic)

    async def endpoints(self, topic: str, within_s: float | None = None) -> TopicEndpoints:
        """Return the publishers and subscribers of a topic; empty if the graph does not have it."""
        return self._present(topic, await self._settled(protocol.EndpointsReply, "endpoints", within_s, topic=topic))

    async def wait_for(
        self,
        topic: str,
        *,
        publishers: int = 0,
        subscribers: int = 0,
        timeout_s: float,
        present: TopicEndpoints | None = None,
    ) -> TopicEndpoints:
        """Wait until a topic has at least these numbers of endpoints, and return its endpoints, after a time-out as
        they are.

        A caller that has just queried the endpoints passes them as `present`, which saves a round trip.
        """
        present = present or await self.endpoints(topic)
        if len(present.publishers) >= publishers and len(present.subscribers) >= subscribers:
            return present
        try:
            reply = await self.query(
                protocol.EndpointsReply,
                "wait_endpoints",
                topic=topic,
                publishers=publishers,
                subscribers=subscribers,
                timeout_s=timeout_s,
            )
        except TimedOut:
            return await self.endpoints(topic)
        return self._present(topic, reply)

    def _present(self, topic: str, reply: protocol.EndpointsReply) -> TopicEndpoints:
        """Return the endpoints as rows, and record them as seen."""
        own = self.own_nodes
        publishers = [Endpoint.parse(endpoint, own) for endpoint in reply["publishers"]]
        for publisher in publishers:
            self.seen.note(publisher.node, {topic: publisher.type})
        subscribers = [Endpoint.parse(endpoint, own) for endpoint in reply["subscribers"]]
        self.seen.note_subscribers(topic, [subscriber.node for subscriber in subscribers])
        return TopicEndpoints(topic, publishers, subscribers, reply["settled"])

    async def no_such_topic(self, topic: str) -> NotFound:
        """Return the error for a topic that does not exist, or was not discovered yet, with the nearest name."""
        found = await self.topics()
        if not found.settled:
            return NotFound(f"{topic} is not seen yet, but discovery is still under way.", "Ask again in a moment.")
        known = [row.name for row in found]
        hint = await self.near(topic, known, "ros2_topic_list")
        return NotFound(f"There is no topic {topic}: it has no publisher and no subscriber.", hint)

    async def missing(self, message: str, hint: str) -> NotFound:
        """Return the error for a missing part of the robot; if no robot is present at all, the error says that
        instead.
        """
        if absence := await self.absence():
            return NotFound(absence, "ros2_status shows domain and middleware.")
        return NotFound(message, hint)

    async def near_topic(self, topic: str) -> str:
        """Return a hint with the topic that was most likely meant; "" if no name is near."""
        return names.did_you_mean(topic, _others(topic, [row.name for row in await self.topics()]))

    async def near(self, name: str, known: Sequence[str], tool: str) -> str:
        """Return a hint for a name that does not exist: the nearest name, that no robot is present, or the listing
        tool.
        """
        return names.did_you_mean(name, _others(name, known)) or await self.absence() or f"{tool} shows what is there."


def _nodes(found: Sequence[tuple[str, str]], *, settled: bool) -> Rows[NodeRow]:
    return Rows([NodeRow(names.full_node_name(*row)) for row in found], settled)


def _others(name: str, known: Sequence[str]) -> list[str]:
    """Return the known names that may have been meant; hidden names only if the given name is hidden."""
    return [each for each in known if each != name and (names.is_hidden(name) or not names.is_hidden(each))]


def was_refused(error: RobotError) -> bool:
    """Return whether nothing was sent of the request that raised this error: it was stopped before, or refused."""
    if isinstance(error, Stopped):
        return not error.may_have_left
    refused = error if isinstance(error, BridgeRefused) else error.__cause__
    return isinstance(refused, BridgeRefused) and refused.kind in _NOTHING_SENT
