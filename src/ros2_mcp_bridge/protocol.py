"""What crosses the stream, as types that server and bridge share. docs/reference/stream.md says what it means.

A request is `{"id", "op", ...arguments}`; its answer is `{"id", "ok"}` or `{"id", "error"}`. Arguments are checked
where they are read (`request.Request`); here is the `ok` part of each answer (`…Reply`). The table of operations is in
`__main__.py` and `operations.py`.
"""

from __future__ import annotations

from typing import Literal, NamedTuple, TypedDict

# Said in `hello`; the server refuses a bridge of another number. It grows with every change that an older end of the
# stream would misunderstand.
PROTOCOL = 3

# `stopped`: `ros2_stop` or the end of the link lease came after what is refused or ended with it was accepted.
ErrorKind = Literal[
    "bad_request", "unknown_type", "not_found", "timeout", "cancelled", "stopped", "server_gone", "ros_error"
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


class FrameIdChanged(TypedDict):
    """The `frame` event: the commands of a velocity topic have another frame from now on; their zero keeps it."""

    event: Literal["frame"]
    topic: str
    frame_id: str


class Lapsed(TypedDict):
    """The `lapsed` event: the server was silent for longer than its link lease, and all that moved was ended."""

    event: Literal["lapsed"]
    silent_s: float


# ── what several operations share ──────────────────────────────────────────────────────────────────────────────

NamesAndTypes = list[tuple[str, list[str]]]
Keep = Literal["all", "latest"]


class Empty(TypedDict):
    """Nothing to say."""


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


class Cancelled(TypedDict):
    """Whether the server withdrew it."""

    cancelled: bool


EndedBy = Literal["", "cancel", "stop", "lease"]


class Ended(TypedDict):
    """What ended it before its time: a request `cancel`, the request `stop`, or a link lease that lapsed."""

    ended_by: EndedBy


# ── what needs no ROS ──────────────────────────────────────────────────────────────────────────────────────────


class PingReply(TypedDict):
    """How long ago the ROS thread went round its loop."""

    ros_idle_s: float


class InterfacesReply(TypedDict):
    """`package/kind/Name` of all that the ament index lists."""

    interfaces: list[str]


class Definition(TypedDict):
    """The text of an interface, and how it is written: `msg`, `srv`, `action` or `idl`."""

    format: str
    text: str


class DefinitionsReply(TypedDict):
    """The definitions by type, with all that they refer to."""

    definitions: dict[str, Definition]
    missing: list[str]


# ── the graph ──────────────────────────────────────────────────────────────────────────────────────────────────


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


class NodeReply(TypedDict):
    """Names and types of what it publishes, subscribes, serves and calls."""

    publishers: NamesAndTypes
    subscribers: NamesAndTypes
    servers: NamesAndTypes
    clients: NamesAndTypes


class EndpointsReply(Settled):
    """Who publishes and who subscribes."""

    publishers: list[Endpoint]
    subscribers: list[Endpoint]


# ── messages ───────────────────────────────────────────────────────────────────────────────────────────────────


class SubscribeReply(TypedDict):
    """The number of the subscription."""

    sub: int


class PublishReply(TypedDict):
    """Who got it; `acked` is None where somebody acknowledges nothing."""

    matched: int
    acked: bool | None
    created: bool
    waited_s: float


class RepeatReply(Ended):
    """What was sent."""

    sent: int
    matched: int
    elapsed_s: float
    late: int
    final_sent: bool


class RelayCounts(TypedDict):
    """What became of the messages of a relay; `refused` are velocities that are not finite or cannot be decoded."""

    running: bool
    passed: int
    dropped: int
    refused: int
    lost: int | None
    publishers: int
    matched: int
    elapsed_s: float


class RelayEnd(RelayCounts):
    """The same, when it has ended."""

    final_sent: bool


class RelayReply(RelayEnd, Ended):
    """The same, when it is answered."""


class RelayFeedReply(TypedDict):
    """How many have passed so far."""

    passed: int


class RelaysReply(TypedDict):
    """Those that are open, by name."""

    relays: dict[str, RelayCounts]


class RelayStopReply(TypedDict):
    """How many were ended."""

    relays: int


class StoppedTopic(TypedDict):
    """A velocity topic that got its zero; `acked` is None where somebody acknowledges nothing."""

    topic: str
    type: str
    matched: int
    acked: bool | None


class ZeroReply(TypedDict):
    """What became of the zeros."""

    topics: list[StoppedTopic]


class StopReply(ZeroReply):
    """How many requests were ended, and what was accepted before and never left: operation and name of each."""

    repeats: int
    relays: int
    dropped: list[tuple[str, str]]


# ── services ───────────────────────────────────────────────────────────────────────────────────────────────────


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
