"""Show one topic in detail, as `ros2 topic info --verbose` does, and why endpoints do not match."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from ros2_mcp.model import qos
from ros2_mcp.model.qos import Endpoint
from ros2_mcp.model.text import counted, named
from ros2_mcp.ops.results.results import SAID
from ros2_mcp.robot import Robot


@dataclass(frozen=True, slots=True, kw_only=True)
class EndpointInfo:
    """A publisher or subscriber with its QoS, which decides whether a pair matches; a time is null if infinite or
    unknown.

    `from_this_server`: it belongs to this server, which keeps its publishers for a while after use.
    """

    node: str
    type: str
    reliability: str
    durability: str
    history: str
    depth: int | None
    deadline_s: float | None
    lifespan_s: float | None
    liveliness: str
    liveliness_lease_s: float | None
    from_this_server: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicInfo:
    """All that discovery reports about one topic; `mismatches` has a sentence for each pair whose types or QoS do not
    match.
    """

    topic_name: str = field(metadata=SAID)
    topic_types: Sequence[str] = field(metadata=SAID)
    type_hash: str
    publishers: Sequence[EndpointInfo]
    subscribers: Sequence[EndpointInfo]
    mismatches: Sequence[str] = field(metadata=SAID)

    def summary(self) -> list[str]:
        """Return one line, and one line for each mismatch."""
        publishers, subscribers = (
            f"{counted(len(side), what)}{_own_count(side)}"
            for side, what in ((self.publishers, "publisher"), (self.subscribers, "subscriber"))
        )
        types = ", ".join(map(named, self.topic_types))
        return [f"{self.topic_name} ({types}): {publishers}, {subscribers}.", *self.mismatches]


async def topic_info(robot: Robot, topic: str) -> TopicInfo:
    """Return the endpoints of a topic with their QoS, and why pairs of them do not match.

    Raises:
        NotFound: if the topic has neither a publisher nor a subscriber.
    """
    topic = await robot.graph.name_of(topic)
    found = await robot.graph.endpoints(topic)
    if not found.types:
        raise await robot.graph.no_such_topic(topic)
    hashes = {endpoint.hash for endpoint in (*found.publishers, *found.subscribers) if endpoint.hash}
    return TopicInfo(
        topic_name=topic,
        topic_types=found.types,
        type_hash=", ".join(sorted(hashes)),
        publishers=[_endpoint(publisher) for publisher in found.publishers],
        subscribers=[_endpoint(subscriber) for subscriber in found.subscribers],
        mismatches=mismatches(found.publishers, found.subscribers),
    )


def mismatches(publishers: Sequence[Endpoint], subscribers: Sequence[Endpoint]) -> list[str]:
    """Return one sentence for each pair that exchanges no messages."""
    pairs = [(publisher, subscriber) for publisher in publishers for subscriber in subscribers]
    reasons = [_pair_mismatch(publisher, subscriber) for publisher, subscriber in pairs]
    return [f"{pair[0].who} → {pair[1].who}: {why}." for pair, why in zip(pairs, reasons, strict=True) if why]


def _pair_mismatch(publisher: Endpoint, subscriber: Endpoint) -> str:
    if publisher.type != subscriber.type:
        return f"the types differ, {publisher.type} and {subscriber.type}"
    # Equal names with different hashes: the two were built from different versions of the definition. Before Jazzy
    # endpoints have no hash.
    if publisher.hash and subscriber.hash and publisher.hash != subscriber.hash:
        return f"both say {publisher.type}, but their definitions differ ({publisher.hash}, {subscriber.hash})"
    return qos.mismatch(publisher.qos, subscriber.qos)


def _endpoint(endpoint: Endpoint) -> EndpointInfo:
    policies = endpoint.qos
    return EndpointInfo(
        node=endpoint.node,
        type=endpoint.type,
        reliability=policies.reliability,
        durability=policies.durability,
        history=policies.history,
        depth=policies.depth,
        deadline_s=_seconds(policies.deadline_ns),
        lifespan_s=_seconds(policies.lifespan_ns),
        liveliness=policies.liveliness,
        liveliness_lease_s=_seconds(policies.liveliness_lease_ns),
        from_this_server=endpoint.ours,
    )


def _seconds(duration_ns: int | None) -> float | None:
    return None if duration_ns is None else duration_ns / 1e9


def _own_count(side: Sequence[EndpointInfo]) -> str:
    """Return a phrase with the number of this server's own endpoints; empty if there are none."""
    count = sum(endpoint.from_this_server for endpoint in side)
    return f" ({count} of this server)" if count else ""
