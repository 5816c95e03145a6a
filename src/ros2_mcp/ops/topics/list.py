"""Topics: which there are, and who speaks to whom on them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ros2_mcp.model import names, qos
from ros2_mcp.model.graph import OF_EVERY_NODE, TopicRow
from ros2_mcp.model.qos import Endpoint, QoS
from ros2_mcp.robot import Robot


@dataclass(frozen=True, slots=True)
class TopicEntry:
    """One topic; `topic_types` is filled only where there are several, which is a fault of the system."""

    topic_name: str
    topic_type: str
    publishers: int
    subscribers: int
    topic_types: Sequence[str] = ()


@dataclass(frozen=True, slots=True)
class TopicList:
    """The topics of the graph; `settled` is false if discovery was still under way when the wait for it ended."""

    topics: Sequence[TopicEntry]
    total: int
    settled: bool
    note: str

    def summary(self) -> str:
        """One line."""
        return f"{len(self.topics)} of {self.total} topics. {self.note}".rstrip()


@dataclass(frozen=True, slots=True)
class EndpointInfo:
    """A publisher or subscriber, with the policies that decide who matches whom; null where that is not told."""

    node: str
    type: str
    reliability: str
    durability: str
    history: str
    depth: int | None
    deadline_s: float | None
    lifespan_s: float | None
    liveliness: str


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """Everything the graph tells of one topic; `mismatches` says in words which pairs never exchange a message."""

    topic_name: str
    topic_types: Sequence[str]
    type_hash: str
    publishers: Sequence[EndpointInfo]
    subscribers: Sequence[EndpointInfo]
    mismatches: Sequence[str]

    def summary(self) -> str:
        """One line, and one for each mismatch."""
        line = (
            f"{self.topic_name} ({', '.join(self.topic_types)}): {len(self.publishers)} publisher(s), "
            f"{len(self.subscribers)} subscriber(s)."
        )
        return "\n".join([line, *self.mismatches])


async def list_topics(robot: Robot, pattern: str = "", include_hidden: bool = False, limit: int = 200) -> TopicList:
    """The topics whose names match the pattern (a glob, or any part of a name), sorted by name."""
    found = await robot.graph.topics()
    visible = {row.name: row for row in found if include_hidden or not names.is_hidden(row.name)}
    chosen = names.matching(sorted(visible), pattern)
    topics = [_entry(visible[name]) for name in chosen[:limit]]
    note = _list_note(len(topics), len(chosen), found.settled)
    if visible.keys() <= OF_EVERY_NODE:
        note = f"{note} {_alone(robot)}".strip()
    return TopicList(topics, len(visible), found.settled, note)


def _entry(row: TopicRow) -> TopicEntry:
    types = row.types if len(row.types) > 1 else ()
    return TopicEntry(row.name, row.types[0], row.publishers, row.subscribers, types)


def _alone(robot: Robot) -> str:
    domain = "this domain" if robot.graph.domain_id is None else f"domain {robot.graph.domain_id}"
    return (
        f"No topic of a robot is seen in {domain}: is the robot on, in the same domain (ROS_DOMAIN_ID), and reachable "
        "from here?"
    )


def _list_note(shown: int, matching: int, settled: bool) -> str:
    notes: list[str] = []
    if shown < matching:
        notes.append(f"{matching} match, the first {shown} are shown: narrow the pattern or raise the limit.")
    if not settled:
        notes.append("Discovery had not settled yet: the list may be incomplete, ask again.")
    return " ".join(notes)


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
        topic,
        found.types,
        ", ".join(sorted(hashes)),
        [_info(endpoint) for endpoint in found.publishers],
        [_info(endpoint) for endpoint in found.subscribers],
        mismatches(found.publishers, found.subscribers),
    )


def mismatches(publishers: Sequence[Endpoint], subscribers: Sequence[Endpoint]) -> list[str]:
    """One sentence for each pair that never exchanges a message."""
    pairs = ((publisher, subscriber) for publisher in publishers for subscriber in subscribers)
    return [
        f"{publisher.node} → {subscriber.node}: {reason}."
        for publisher, subscriber in pairs
        if (reason := _pair_mismatch(publisher, subscriber))
    ]


def _pair_mismatch(publisher: Endpoint, subscriber: Endpoint) -> str:
    if publisher.type != subscriber.type:
        return f"the types differ, {publisher.type} and {subscriber.type}"
    if publisher.hash and subscriber.hash and publisher.hash != subscriber.hash:
        return f"both say {publisher.type}, but their definitions differ ({publisher.hash}, {subscriber.hash})"
    return qos.mismatch(publisher.qos, subscriber.qos)


def _info(endpoint: Endpoint) -> EndpointInfo:
    policies: QoS = endpoint.qos
    return EndpointInfo(
        endpoint.node,
        endpoint.type,
        policies.reliability,
        policies.durability,
        policies.history,
        policies.depth,
        _seconds(policies.deadline_ns),
        _seconds(policies.lifespan_ns),
        policies.liveliness,
    )


def _seconds(duration_ns: int | None) -> float | None:
    return None if duration_ns is None else duration_ns / 1e9
