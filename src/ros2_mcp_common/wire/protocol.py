"""What crosses the stream, as types that server and bridge share. docs/reference/stream.md says what it means.

A request is `{"id", "op", ...arguments}`; its answer is `{"id", "ok"}` or `{"id", "error"}`. Arguments are checked
where they are read (`request.Request`); here is the `ok` part of each answer (`…Reply`). The table of operations is in
`__main__.py` and `operations.py`.
"""

from __future__ import annotations

from typing import Literal, NamedTuple, TypedDict

# Said in `hello`; the server refuses a bridge of another number. It grows with every change that an older end of the
# stream would misunderstand.
PROTOCOL = 5

# How the names of bridges' nodes begin; the number of the process follows.
BRIDGE_NODE = "ros2_mcp_"

# `stopped`: `ros2_stop` came after what is refused or ended with it was accepted; `lapsed`: the link lease lapsed then;
# `latched`: the latch is set, or was set then.
ErrorKind = Literal[
    "bad_request", "unknown_type", "not_found", "timeout", "cancelled", "stopped", "lapsed", "latched", "server_gone",
    "ros_error", "refused",
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
    """One row of a `samples` event. Times are Unix times; `sequence` is None where the middleware tells none.

    `size` bytes of it are in the body; `whole` is how many it has where those are only its head, else 0.
    """

    received_ns: int
    source_ns: int
    sequence: int | None
    size: int
    whole: int


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


class RepeatBegun(TypedDict):
    """The `begun` event: the first message of the repeat of that name has just been sent, or the condition of the
    `cancel_when` of that name is being asked.
    """

    event: Literal["begun"]
    name: str


class StopperEvent(TypedDict):
    """The `stopper` event: it has `acted`, as the bridge was stopped or silent; or it was `lost`, and what moved was
    ended.
    """

    event: Literal["stopper"]
    what: Literal["acted", "lost"]
    message: str


class Spent(TypedDict):
    """The `spent` event: one more was used of what the policy allows of that name, by the minute or at a slow rate."""

    event: Literal["spent"]
    name: str
    type: str
    bound: Literal["per_minute", "rate_hz"]


class Lapsed(TypedDict):
    """The `lapsed` event: the server was silent for longer than its link lease, and all that moved was ended."""

    event: Literal["lapsed"]
    silent_s: float


class LatchSet(TypedDict):
    """The `latched` event: the latch was set, or found set, by somebody; all that moved was ended."""

    event: Literal["latched"]
    by: str
    reason: str
    own: bool


class MotionProgress(TypedDict):
    """The `motion` event: what can be told now of the motion of that name, by its controller."""

    event: Literal["motion"]
    name: str
    report: dict[str, object]


Told = FrameIdChanged | Lapsed | LatchSet | MotionProgress | RepeatBegun | Spent | StopperEvent
"""What the bridge tells unasked, beside samples."""


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


EndedBy = Literal["", "cancel", "stop", "lease", "latch", "stopper"]


class Ended(TypedDict):
    """What ended it before its time: a request `cancel`, the request `stop`, a link lease that lapsed, the latch, or
    the death of the stopper.
    """

    ended_by: EndedBy


# ── what needs no ROS ──────────────────────────────────────────────────────────────────────────────────────────


class PingReply(TypedDict):
    """How long ago the ROS thread went round its loop; the robot's clock when it answered, in ns of Unix time, and the
    `sent_ns` of the ping. `steady_s` is its steady clock then, which a ping over a network brings back as `heard_s`.
    """

    ros_idle_s: float
    now_ns: int
    sent_ns: float
    steady_s: float


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


NOT_COUNTED = -1
"""In the place of a topic's numbers, where there are more topics than were to be counted."""


class TopicsReply(Settled):
    """Names, types, and numbers of publishers and subscribers; and the names and namespaces of all nodes."""

    topics: list[tuple[str, list[str], int, int]]
    nodes: list[tuple[str, str]]


class CountedReply(TypedDict):
    """The numbers of publishers and subscribers of each topic, in the order in which they were asked for."""

    counted: list[tuple[int, int]]


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


class ServersReply(TypedDict):
    """Names and namespaces of the nodes that serve a service."""

    servers: list[tuple[str, str]]


class EndpointsReply(Settled):
    """Who publishes and who subscribes."""

    publishers: list[Endpoint]
    subscribers: list[Endpoint]


# ── messages ───────────────────────────────────────────────────────────────────────────────────────────────────


class SubscribeReply(TypedDict):
    """The number of the subscription."""

    sub: int


class PolicyReply(TypedDict):
    """The rules that hold from now on."""

    digest: str


class Guarded(TypedDict):
    """How long it waited for the stopper, and in words why it went on without one; "" where it did not."""

    stopper_s: float
    unguarded: str


class PublishReply(Guarded):
    """How many got it, and how many of them are this server's own; `acked` is None where somebody acknowledges nothing.
    `limited` is 1 where less was sent than was asked for; `hold_s` is after how long the policy sends the zero, 0 where
    it does not. `endpoints` is how many publishers and subscribers the topic has afterwards, whoever they are.
    """

    matched: int
    ours: int
    acked: bool | None
    created: bool
    waited_s: float
    limited: int
    hold_s: float
    endpoints: tuple[int, int]


class RepeatReply(Ended, Guarded):
    """What was sent; `limited` is of how many messages less was sent than was asked for."""

    sent: int
    matched: int
    ours: int
    elapsed_s: float
    late: int
    limited: int
    final_sent: bool


class MotionReply(RepeatReply):
    """What ended a motion, in a word and a sentence, both "" where `ended_by` says it; and what its controller tells of
    it at the end.
    """

    outcome: str
    why: str
    report: dict[str, object]


class RelayCounts(Guarded):
    """What became of the messages of a relay; `refused` are what the policy holds back, and velocities that are not
    finite or cannot be decoded; of `limited` less was sent than came.
    """

    running: bool
    passed: int
    dropped: int
    refused: int
    limited: int
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
    """A velocity topic that got its zero; `acked` is None where somebody acknowledges nothing.

    `problem` says in words why nothing could be sent that ends the motion; "" where it was.
    """

    topic: str
    type: str
    matched: int
    acked: bool | None
    problem: str


class ZeroReply(TypedDict):
    """What became of the zeros."""

    topics: list[StoppedTopic]


class StopReply(ZeroReply):
    """How many requests were ended, and what was accepted before and never left: operation and name of each."""

    repeats: int
    relays: int
    dropped: list[tuple[str, str]]


class JointsReply(TypedDict):
    """How joints move, by name: position in rad or m, and speed per second; None where nobody tells it. What is not
    heard of is left out.
    """

    joints: dict[str, tuple[float, float | None]]


# ── services ───────────────────────────────────────────────────────────────────────────────────────────────────


class CallReply(TypedDict):
    """How long it took; the body is the CDR of the response."""

    waited_s: float
    elapsed_s: float


class CancelWhenReply(TypedDict):
    """After what time the condition was met, and what it was asked of (`asking.Asking.report`); the body is the CDR of
    the response to the request to cancel.
    """

    met_s: float
    report: dict[str, object]


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
