"""One topic in detail, as `ros2 topic info --verbose` shows it, and why endpoints do not match."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ros2_mcp.model import names, qos
from ros2_mcp.model.qos import Endpoint
from ros2_mcp.model.text import named
from ros2_mcp.robot import Robot


@dataclass(frozen=True, slots=True, kw_only=True)
class EndpointInfo:
    """A publisher or subscriber with its QoS, which decides whether a pair matches; null if infinite or unknown."""

    node: str
    type: str
    reliability: str
    durability: str
    history: str
    depth: int | None
    deadline_s: float | None
    lifespan_s: float | None
    liveliness: str


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicInfo:
    """Everything that the graph knows of one topic; `mismatches` says in words which pairs exchange no messages."""

    topic_name: str
    topic_types: Sequence[str]
    type_hash: str
    publishers: Sequence[EndpointInfo]
    subscribers: Sequence[EndpointInfo]
    mismatches: Sequence[str]

    def summary(self) -> list[str]:
        """One line, and one for each mismatch."""
        line = (
            f"{self.topic_name} ({', '.join(map(named, self.topic_types))}): {len(self.publishers)} publisher(s), "
            f"{len(self.subscribers)} subscriber(s)."
        )
        return [line, *self.mismatches]


async def topic_info(robot: Robot, topic: str) -> TopicInfo:
    """The endpoints of a topic with their QoS, and why pairs of them do not match.

    Raises:
        NotFound: if nobody publishes or subscribes to it.
    """
    topic = names.absolute(topic)
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
    """One sentence for each pair that exchanges no messages."""
    pairs = [(publisher, subscriber) for publisher in publishers for subscriber in subscribers]
    reasons = [_pair_mismatch(publisher, subscriber) for publisher, subscriber in pairs]
    return [f"{pair[0].node} → {pair[1].node}: {why}." for pair, why in zip(pairs, reasons, strict=True) if why]


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
        deadline_s=None if policies.deadline_ns is None else policies.deadline_ns / 1e9,
        lifespan_s=None if policies.lifespan_ns is None else policies.lifespan_ns / 1e9,
        liveliness=policies.liveliness,
    )
