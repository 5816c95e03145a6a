"""The contents of the stream, as types that server and bridge share. docs/reference/stream.md says what they mean.

A request is `{"id", "op", ...arguments}`; its answer is `{"id", "ok"}` or `{"id", "error"}`. Arguments are checked
where they are read (`request.Request`); this module has the `ok` part of each answer (`…Reply`). The table of
operations is in `__main__.py` and `operations.py`.
"""

from __future__ import annotations

from typing import Literal, NamedTuple, TypedDict

# The version in `hello`; the server rejects a bridge of another version. It grows with every change that an older end
# of the stream would misunderstand.
PROTOCOL = 5

# The prefix of the names of bridges' nodes; the process id follows.
BRIDGE_NODE = "ros2_mcp_"

# `stopped`, `lapsed` and `latched` mean that after the request was accepted `ros2_stop` was called, the link lease
# lapsed, or the latch was set. `latched` also means that the latch is set now.
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
    """The bridge's first event. On the stream it is an object with these entries, `event` and `protocol`."""

    python: str
    distro: str
    rmw: str
    domain_id: int
    node: str
    pid: int
    executor: str


class SampleHead(NamedTuple):
    """One row of a `samples` event. Times are Unix times in ns; `sequence` is None if the
    middleware does not provide it.

    `size` bytes of the message are in the body. If that is only its head, `whole` is the size of
    the whole message, else 0.
    """

    received_ns: int
    source_ns: int
    sequence: int | None
    size: int
    whole: int


class Counts(TypedDict):
    """The numbers of messages of a subscription that were received, dropped by the bridge, and lost before the bridge;
    `lost` is None if unknown.
    """

    received: int
    dropped: int
    lost: int | None


class Samples(Counts):
    """The `samples` event; its body is the concatenated CDR of the samples."""

    event: Literal["samples"]
    sub: int
    samples: list[SampleHead]


class FrameIdChanged(TypedDict):
    """The `frame` event: the commands on a velocity topic have a new frame, which its zero will use."""

    event: Literal["frame"]
    topic: str
    frame_id: str


class RepeatBegun(TypedDict):
    """The `begun` event: the first message of the repeat of that name was sent, or the `cancel_when` of that name has
    begun to evaluate its condition.
    """

    event: Literal["begun"]
    name: str


class StopperEvent(TypedDict):
    """The `stopper` event: a stopper has `acted`, because the bridge was suspended or silent, or was `lost`,
    and all motion was ended.
    """

    event: Literal["stopper"]
    what: Literal["acted", "lost"]
    message: str


class Spent(TypedDict):
    """The `spent` event: one use of that name was counted against the policy's limit per
    minute, or against a slow rate.
    """

    event: Literal["spent"]
    name: str
    type: str
    bound: Literal["per_minute", "rate_hz"]


class Lapsed(TypedDict):
    """The `lapsed` event: the server was silent for longer than its link lease, and all motion was ended."""

    event: Literal["lapsed"]
    silent_s: float


class LatchSet(TypedDict):
    """The `latched` event: the latch was set, or found to be set, and all motion was ended.

    `own`: this bridge set it in memory, and the latch on the server's machine does not have the setting yet.
    """

    event: Literal["latched"]
    by: str
    reason: str
    own: bool


class KeptOut(TypedDict):
    """The `kept_out` event: what drove the robot towards a keep-out zone was ended; `reason` says where."""

    event: Literal["kept_out"]
    reason: str


class MotionProgress(TypedDict):
    """The `motion` event: the current report of the controller of the motion of that name."""

    event: Literal["motion"]
    name: str
    report: dict[str, object]


Told = FrameIdChanged | KeptOut | Lapsed | LatchSet | MotionProgress | RepeatBegun | Spent | StopperEvent
"""The events of the bridge besides `hello` and samples."""


# ── what several operations share ──────────────────────────────────────────────────────────────────────────────

NamesAndTypes = list[tuple[str, list[str]]]
Keep = Literal["all", "latest"]


class Empty(TypedDict):
    """An `ok` without contents."""


class EndpointQoS(TypedDict):
    """The `qos` of an endpoint. "unknown" is what the middleware does not report; None is an infinite duration."""

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
    """Whether the server cancelled the request."""

    cancelled: bool


EndedBy = Literal["", "cancel", "stop", "lease", "latch", "stopper", "keep_out"]


class Ended(TypedDict):
    """The reason why a request ended early: a request `cancel`, the request `stop`, a lapsed link lease, the latch, or
    the death of a stopper.
    """

    ended_by: EndedBy


# ── what needs no ROS ──────────────────────────────────────────────────────────────────────────────────────────


class PingReply(TypedDict):
    """The time since the last turn of the ROS thread (s), the robot's clock at the answer (Unix time, ns), and the
    `sent_ns` of the ping.

    `steady_s` is the robot's steady clock at that time. Over a network, the next ping returns it as `heard_s`.
    """

    ros_idle_s: float
    now_ns: int
    sent_ns: float
    steady_s: float


class InterfacesReply(TypedDict):
    """The names `package/kind/Name` of all interfaces in the ament index."""

    interfaces: list[str]


class Definition(TypedDict):
    """The text of an interface definition and its format: `msg`, `srv`, `action` or `idl`."""

    format: str
    text: str


class DefinitionsReply(TypedDict):
    """The definitions by type, including all types that they refer to, and the types that were not found."""

    definitions: dict[str, Definition]
    missing: list[str]


# ── the graph ──────────────────────────────────────────────────────────────────────────────────────────────────


class Settled(TypedDict):
    """Whether discovery had settled."""

    settled: bool


NOT_COUNTED = -1
"""Stands for the counts of a topic if there are more topics than were to be counted."""


class TopicsReply(Settled):
    """The topics (name, types, counts of publishers and subscribers), and the names and namespaces of all nodes."""

    topics: list[tuple[str, list[str], int, int]]
    nodes: list[tuple[str, str]]


class CountedReply(TypedDict):
    """The counts of publishers and subscribers of each topic, in the order of the request."""

    counted: list[tuple[int, int]]


class ServicesReply(Settled):
    """The names and types of services."""

    services: NamesAndTypes


class NodesReply(Settled):
    """The names and namespaces of nodes."""

    nodes: list[tuple[str, str]]


class NodeReply(TypedDict):
    """The names and types of a node's publishers, subscribers, service servers and service clients."""

    publishers: NamesAndTypes
    subscribers: NamesAndTypes
    servers: NamesAndTypes
    clients: NamesAndTypes


class ServersReply(TypedDict):
    """The names and namespaces of the nodes that serve a service."""

    servers: list[tuple[str, str]]


class EndpointsReply(Settled):
    """The publishers and subscribers of a topic."""

    publishers: list[Endpoint]
    subscribers: list[Endpoint]


# ── messages ───────────────────────────────────────────────────────────────────────────────────────────────────


class SubscribeReply(TypedDict):
    """The number of the subscription."""

    sub: int


class PolicyReply(TypedDict):
    """The digest of the rules now in force."""

    digest: str


class Guarded(TypedDict):
    """The time that the request waited for the stoppers (s), and why it continued without one ("" if it did not)."""

    stopper_s: float
    unguarded: str


class PublishReply(Guarded):
    """The number of matched subscribers, the number of subscribers that belong to this server (`ours`), and whether all
    acknowledged (`acked`).

    `acked` is None if a subscriber does not acknowledge. `limited` is 1 if the values were reduced to the policy's
    limits. `hold_s` is the time after which the policy sends the zero, 0 if it does not. `endpoints` are the counts of
    all publishers and subscribers of the topic afterwards.
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
    """The result of publishing a message repeatedly; `limited` counts the messages whose values were reduced to the
    policy's limits.
    """

    sent: int
    matched: int
    ours: int
    elapsed_s: float
    late: int
    limited: int
    final_sent: bool


class MotionReply(RepeatReply):
    """The result of a motion: what ended it, as a word and a sentence, both "" if `ended_by` says it; and its
    controller's last report.
    """

    outcome: str
    why: str
    report: dict[str, object]


class RelayCounts(Guarded):
    """The counts of a relay.

    `refused`: held back by the policy, or velocities that are not finite or cannot be decoded. `limited`: values
    were reduced to the limits.
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
    """The counts of a relay that has ended."""

    final_sent: bool


class RelayReply(RelayEnd, Ended):
    """The answer to a relay request, at its end."""


class RelayFeedReply(TypedDict):
    """The number of messages published so far."""

    passed: int


class RelaysReply(TypedDict):
    """The relays in progress, by name."""

    relays: dict[str, RelayCounts]


class RelayStopReply(TypedDict):
    """The number of relays that were ended."""

    relays: int


class StoppedTopic(TypedDict):
    """A velocity topic to which the zero was sent; `acked` is None if a subscriber does not acknowledge.

    `problem` says why no message that ends the motion could be sent; "" if it was sent.
    """

    topic: str
    type: str
    matched: int
    acked: bool | None
    problem: str


class ZeroReply(TypedDict):
    """The outcome of the zeros by topic."""

    topics: list[StoppedTopic]


class StopReply(ZeroReply):
    """The numbers of ended repeats and relays, and the accepted requests that were dropped before they were sent:
    (operation, name).
    """

    repeats: int
    relays: int
    dropped: list[tuple[str, str]]


class JointsReply(TypedDict):
    """The state of joints by name: position in rad or m, and speed per second (None if not reported).

    Joints without a measurement are omitted.
    """

    joints: dict[str, tuple[float, float | None]]


# ── services ───────────────────────────────────────────────────────────────────────────────────────────────────


class CallReply(TypedDict):
    """The duration of the call, in s; the body is the CDR of the response."""

    waited_s: float
    elapsed_s: float


class CancelWhenReply(TypedDict):
    """After what time the condition was met (s), and the messages on which it was evaluated (`asking.Asking.report`).

    The body is the CDR of the response to the cancel request.
    """

    met_s: float
    report: dict[str, object]


# ── the bridge itself ──────────────────────────────────────────────────────────────────────────────────────────


class StatsReply(TypedDict):
    """The resources in use by the bridge."""

    publishers: int
    subscriptions: int
    clients: int
    threads: int
    open_files: int
    rss_bytes: int
    repeats: int
    uptime_s: float
