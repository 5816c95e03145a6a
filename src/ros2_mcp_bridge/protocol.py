"""What crosses the stream, as types that server and bridge share. docs/reference/stream.md says what it means.

A request is `{"id", "op", ...arguments}`; its answer is `{"id", "ok"}` or `{"id", "error"}`. For each operation there
are its arguments (`…Arguments`; those of a class with `total=False` may be absent) and the `ok` part of its answer
(`…Reply`). `OPERATIONS` names them all.
"""

from __future__ import annotations

from typing import Literal, NamedTuple, TypedDict

# Said in `hello`; the server refuses a bridge of another number. It grows with every change that an older end of the
# stream would misunderstand.
PROTOCOL = 1

ErrorKind = Literal[
    "bad_request", "unknown_type", "not_found", "timeout", "cancelled", "server_gone", "ros_error"
]  # fmt: skip


class Failure(TypedDict):
    """The `error` part of an answer."""

    kind: ErrorKind
    message: str
    hint: str


# ── events ─────────────────────────────────────────────────────────────────────────────────────────────────────


class Hello(NamedTuple):
    """How the bridge introduces itself; on the stream an object of these, with `event` and `protocol`."""

    python: str
    distro: str
    rmw: str
    domain_id: int
    node: str
    pid: int
    executor: str


class SampleHead(NamedTuple):
    """One row of a `samples` event. Times are Unix times; `sequence` is None where the middleware tells none."""

    received_ns: int
    source_ns: int
    sequence: int | None
    size: int


class Counts(TypedDict):
    """What became of a subscription's messages; `lost` is None where it cannot be known."""

    received: int
    dropped: int
    lost: int | None


class Samples(Counts):
    """The `samples` event; its body is the samples' CDR one after the other."""

    event: Literal["samples"]
    sub: int
    samples: list[SampleHead]


# ── what several operations share ──────────────────────────────────────────────────────────────────────────────

NamesAndTypes = list[tuple[str, list[str]]]
Keep = Literal["all", "latest"]


class Empty(TypedDict):
    """Nothing to say."""


class QoS(TypedDict, total=False):
    """The `qos` that a request asks for."""

    reliability: Literal["reliable", "best_effort"]
    durability: Literal["volatile", "transient_local"]
    history: Literal["keep_last", "keep_all"]
    depth: int


class EndpointQoS(TypedDict):
    """The `qos` of an endpoint; what the middleware does not tell is "unknown", an infinite duration is None."""

    reliability: str
    durability: str
    history: str
    depth: int | Literal["unknown"]
    deadline_ns: int | None
    lifespan_ns: int | None
    liveliness: str
    liveliness_lease_ns: int | None


class Endpoint(TypedDict):
    """One publisher or subscriber of a topic."""

    node: str
    namespace: str
    type: str
    hash: str
    gid: str
    qos: EndpointQoS


class Destination(TypedDict):
    """Where messages go."""

    topic: str
    type: str
    qos: QoS


class Cancelled(TypedDict):
    """Whether the server ended it before its time."""

    cancelled: bool


# ── what needs no ROS ──────────────────────────────────────────────────────────────────────────────────────────


class PingReply(TypedDict):
    """How long ago the ROS thread went round its loop."""

    ros_idle_s: float


class InterfacesReply(TypedDict):
    """`package/kind/Name` of all that the ament index lists."""

    interfaces: list[str]


class DefinitionsArguments(TypedDict):
    """The types that are asked for."""

    types: list[str]


class Definition(TypedDict):
    """The text of an interface, and how it is written: `msg`, `srv`, `action` or `idl`."""

    format: str
    text: str


class DefinitionsReply(TypedDict):
    """The definitions by type, with all that they refer to."""

    definitions: dict[str, Definition]
    missing: list[str]


class CancelArguments(TypedDict):
    """The id of the request to cancel."""

    request: int


# ── the graph ──────────────────────────────────────────────────────────────────────────────────────────────────


class SettleArguments(TypedDict, total=False):
    """How long to wait for discovery to settle; it is 3 s if not given."""

    settle_s: float


class Settled(TypedDict):
    """Whether discovery had settled."""

    settled: bool


class TopicsReply(Settled):
    """Names, types, and numbers of publishers and subscribers."""

    topics: list[tuple[str, list[str], int, int]]


class ServicesReply(Settled):
    """Names and types."""

    services: NamesAndTypes


class NodesReply(Settled):
    """Names and namespaces."""

    nodes: list[tuple[str, str]]


class NodeArguments(SettleArguments):
    """Which node."""

    name: str
    namespace: str


class NodeReply(TypedDict):
    """Names and types of what it publishes, subscribes, serves and calls."""

    publishers: NamesAndTypes
    subscribers: NamesAndTypes
    servers: NamesAndTypes
    clients: NamesAndTypes


class EndpointsArguments(SettleArguments):
    """Which topic."""

    topic: str


class WaitEndpointsArguments(TypedDict):
    """How many publishers and subscribers to wait for."""

    topic: str
    publishers: int
    subscribers: int
    timeout_s: float


class EndpointsReply(Settled):
    """Who publishes and who subscribes."""

    publishers: list[Endpoint]
    subscribers: list[Endpoint]


# ── messages ───────────────────────────────────────────────────────────────────────────────────────────────────


class SubscribeArguments(Destination):
    """What to receive, and how much of it may wait."""

    keep: Keep
    max_samples: int
    max_bytes: int
    drain_s: float


class SubscribeReply(TypedDict):
    """The number of the subscription."""

    sub: int


class UnsubscribeArguments(TypedDict):
    """The number of the subscription."""

    sub: int


class PublishArguments(Destination, total=False):
    """How long to wait for subscribers, and for their acknowledgement."""

    wait_match_s: float
    wait_ack_s: float


class PublishReply(TypedDict):
    """Who got it; `acked` is None where nobody acknowledges."""

    matched: int
    acked: bool | None
    created: bool
    waited_s: float


class RepeatArguments(PublishArguments):
    """How often and how long; `final_size` bytes at the end of the body are the message sent last."""

    rate_hz: float
    duration_s: float
    final_size: int


class RepeatReply(Cancelled):
    """What was sent."""

    sent: int
    matched: int
    elapsed_s: float
    late: int
    final_sent: bool


class RelayArguments(Destination, total=False):
    """A relay by its name; without a `source` it is fed."""

    name: str
    source: str
    rate_hz: float
    duration_s: float
    wait_match_s: float


class RelayCounts(TypedDict):
    """What became of the messages of a relay."""

    running: bool
    passed: int
    dropped: int
    lost: int | None
    publishers: int
    matched: int
    elapsed_s: float


class RelayEnd(RelayCounts):
    """The same, when it has ended."""

    final_sent: bool


class RelayReply(RelayEnd, Cancelled):
    """The same, when it is answered."""


class RelayFeedArguments(TypedDict):
    """The sizes of the messages that are in the body."""

    name: str
    sizes: list[int]


class RelayFeedReply(TypedDict):
    """How many have passed so far."""

    passed: int


class RelayStopArguments(TypedDict):
    """Which relay."""

    name: str


class RelaysReply(TypedDict):
    """Those that are open, by name."""

    relays: dict[str, RelayCounts]


class StopReply(TypedDict):
    """How many requests were ended."""

    repeats: int
    relays: int


# ── services ───────────────────────────────────────────────────────────────────────────────────────────────────


class ServiceName(TypedDict):
    """Which service."""

    service: str
    type: str


class CallArguments(ServiceName, total=False):
    """How long to wait for a server, for its answer, and for both together."""

    wait_s: float
    timeout_s: float
    within_s: float


class CallReply(TypedDict):
    """How long it took; the body is the CDR of the response."""

    waited_s: float
    elapsed_s: float


# ── the bridge itself ──────────────────────────────────────────────────────────────────────────────────────────


class StatsReply(TypedDict):
    """What the bridge holds."""

    publishers: int
    subscriptions: int
    clients: int
    threads: int
    open_files: int
    rss_bytes: int
    repeats: int
    uptime_s: float


OPERATIONS: dict[str, tuple[type, type]] = {
    "ping": (Empty, PingReply),
    "cancel": (CancelArguments, Empty),
    "topics": (SettleArguments, TopicsReply),
    "services": (SettleArguments, ServicesReply),
    "nodes": (SettleArguments, NodesReply),
    "node": (NodeArguments, NodeReply),
    "endpoints": (EndpointsArguments, EndpointsReply),
    "wait_endpoints": (WaitEndpointsArguments, EndpointsReply),
    "interfaces": (Empty, InterfacesReply),
    "definitions": (DefinitionsArguments, DefinitionsReply),
    "subscribe": (SubscribeArguments, SubscribeReply),
    "unsubscribe": (UnsubscribeArguments, Counts),
    "publish": (PublishArguments, PublishReply),
    "repeat": (RepeatArguments, RepeatReply),
    "call": (CallArguments, CallReply),
    "failsafe_publish": (Destination, Cancelled),
    "failsafe_call": (ServiceName, Cancelled),
    "relay": (RelayArguments, RelayReply),
    "relay_feed": (RelayFeedArguments, RelayFeedReply),
    "relay_stop": (RelayStopArguments, StopReply),
    "relays": (Empty, RelaysReply),
    "stop": (Empty, StopReply),
    "stats": (Empty, StatsReply),
}
"""The arguments and the reply of every operation."""
