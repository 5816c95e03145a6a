"""The rows of the graph: topics, services, nodes and their endpoints; and the state of the bridge itself."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

from ros2_mcp.model.qos import Endpoint
from ros2_mcp_common.wire.protocol import EndedBy

Row = TypeVar("Row")

OF_EVERY_NODE = frozenset({"/parameter_events", "/rosout"})
"""Topics that every ROS system has, and which say nothing about a particular robot."""


@dataclass(frozen=True, slots=True)
class Rows(Generic[Row]):
    """One answer of the graph; `settled` is false if discovery was still in progress when the wait for it ended."""

    rows: Sequence[Row]
    settled: bool

    def __iter__(self) -> Iterator[Row]:
        return iter(self.rows)


@dataclass(frozen=True, slots=True, order=True)
class TopicRow:
    """A topic with the types in use on it and the numbers of its endpoints."""

    name: str
    types: Sequence[str]
    publishers: int
    subscribers: int


@dataclass(frozen=True, slots=True, order=True)
class ServiceRow:
    """A service with its types; more than one type is a fault of the system."""

    name: str
    types: Sequence[str]


@dataclass(frozen=True, slots=True, order=True)
class NodeRow:
    """A node by its full name; several nodes may share a name: a fault."""

    name: str


@dataclass(frozen=True, slots=True, order=True)
class NamedTypes:
    """A topic or service that a node uses, with the types by which it uses it."""

    name: str
    types: Sequence[str]


@dataclass(frozen=True, slots=True)
class NodeEndpoints:
    """The topics that one node publishes and subscribes to, and the services that it serves and calls."""

    publishers: Sequence[NamedTypes]
    subscribers: Sequence[NamedTypes]
    servers: Sequence[NamedTypes]
    clients: Sequence[NamedTypes]


@dataclass(frozen=True, slots=True)
class TopicEndpoints:
    """The publishers and subscribers of one topic. Until discovery has `settled`, there may be more."""

    topic: str
    publishers: Sequence[Endpoint]
    subscribers: Sequence[Endpoint]
    settled: bool = True

    @property
    def types(self) -> list[str]:
        """Every type in use on the topic, sorted."""
        return sorted({endpoint.type for endpoint in (*self.publishers, *self.subscribers)})

    def subscribers_of(self, type_name: str) -> int:
        """Return the number of subscribers of one type."""
        return sum(subscriber.type == type_name for subscriber in self.subscribers)


@dataclass(frozen=True, slots=True, kw_only=True)
class RelayCounts:
    """The outcome so far of the messages of one relay in the bridge.

    `passed` were published, `limited` of them with reduced values. `dropped` were held back by the relay's rate.
    `refused` were rejected by the policy, or are velocities that are not finite or cannot be decoded. `lost` is None if
    the middleware cannot know. `matched` subscribers and `publishers` are the present ones. After the end, `final_sent`
    is whether the zero was sent, and `ended_by` the reason for an early end. `stopper_s` is how long the first message
    waited for the stopper, `unguarded` the reason why it continued without one.
    """

    running: bool = False
    passed: int = 0
    dropped: int = 0
    refused: int = 0
    limited: int = 0
    lost: int | None = 0
    publishers: int = 0
    matched: int = 0
    elapsed_s: float = 0.0
    final_sent: bool = False
    ended_by: EndedBy = ""
    stopper_s: float = 0.0
    unguarded: str = ""


@dataclass(frozen=True, slots=True)
class Contact:
    """A bridge's description of itself when it connects, and measurements of the link; see `BridgeStatus`."""

    distro: str
    rmw: str
    domain_id: int
    clock_offset_s: float | None
    link_rtt_s: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class BridgeStatus:
    """The running bridge: its description of itself, and its present resources.

    `starts` counts the bridges of this server, `restarts` are the reasons why former ones were lost, `found` says why
    this ROS installation was chosen. `clock_offset_s` is how far the robot's clock is ahead of this machine's,
    `link_rtt_s` the shortest round-trip time to the bridge in the last minute; None until they are known.
    """

    python: str
    distro: str
    rmw: str
    domain_id: int
    node: str
    pid: int
    executor: str
    starts: int
    restarts: Sequence[str]
    found: str
    uptime_s: float
    memory_bytes: int
    subscriptions: int
    publishers: int
    clients: int
    clock_offset_s: float | None = None
    link_rtt_s: float | None = None
