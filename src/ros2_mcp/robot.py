"""The only door to the robot: resolve the name, ask the guard, check the values, encode, send.

Everything above this module speaks names and JSON values; everything below it speaks bytes.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ros2_mcp.guard.policy import Policy
from ros2_mcp.guard.running import SentGoals
from ros2_mcp.model import names, qos
from ros2_mcp.model.errors import (
    BridgeRefused,
    LinkError,
    NotFound,
    RobotError,
    TimedOut,
    TypeConflict,
    UnknownInterface,
)
from ros2_mcp.model.qos import Choice, Endpoint
from ros2_mcp.model.samples import Counts, Sample

if TYPE_CHECKING:
    from ros2_mcp.codec.cdr import Codec, Message
    from ros2_mcp.codec.definitions import Definitions
    from ros2_mcp.codec.render import Rendered, RenderOptions
    from ros2_mcp.link.client import Bridge, Reply, Subscription

SETTLE_S = 2.5
VELOCITY_TYPES = frozenset(
    {
        "geometry_msgs/msg/Twist",
        "geometry_msgs/msg/TwistStamped",
        "ackermann_msgs/msg/AckermannDrive",
        "ackermann_msgs/msg/AckermannDriveStamped",
    }
)
"""Types whose messages keep a robot moving, and whose default value stops it."""
_REQUEST_S = 10.0
_KINDS: Mapping[str, type[RobotError]] = {
    "unknown_type": UnknownInterface,
    "not_found": NotFound,
    "timeout": TimedOut,
    "server_gone": NotFound,
}


@dataclass(frozen=True, slots=True)
class TopicEndpoints:
    """Who publishes and who subscribes on one topic."""

    topic: str
    publishers: Sequence[Endpoint]
    subscribers: Sequence[Endpoint]

    @property
    def types(self) -> list[str]:
        """Every type in use on the topic, sorted."""
        return sorted({endpoint.type for endpoint in (*self.publishers, *self.subscribers)})


@dataclass(frozen=True, slots=True)
class Listening:
    """A subscription with what is known about it."""

    topic: str
    type: str
    choice: Choice
    publishers: Sequence[Endpoint]
    _subscription: Subscription

    async def take(self, timeout_s: float) -> list[Sample]:
        """The samples that wait; waits for the first one, returns an empty list when none came in time."""
        return await self._subscription.take(timeout_s)

    @property
    def counts(self) -> Counts:
        """What became of the messages so far."""
        return self._subscription.counts


@dataclass(frozen=True, slots=True)
class Sent:
    """What became of a publication.

    `acked` is None where best effort gives no acknowledgement; `late` counts missed periods of a repetition, which
    ends with a zero command (`stopped_with_zero`) where the type is one that keeps a robot moving.
    """

    topic: str
    type: str
    choice: Choice
    sent: int
    matched: int
    acked: bool | None
    elapsed_s: float
    late: int = 0
    stopped_with_zero: bool = False


@dataclass(frozen=True, slots=True)
class Answer:
    """The response of a service as CDR bytes, and how long it took."""

    body: bytes
    elapsed_s: float


class Robot:
    """One robot: its graph, its definitions, its topics and services."""

    def __init__(self, bridge: Bridge, policy: Policy | None = None) -> None:
        self.bridge = bridge
        self.policy = policy or Policy()
        self._codec: Codec | None = None
        self.goals = SentGoals()
        self._loading = asyncio.Lock()

    # ── the graph ──────────────────────────────────────────────────────────────────────────────────────────────

    async def ask(self, op: str, body: bytes = b"", *, timeout_s: float = _REQUEST_S, **arguments: Any) -> Reply:
        """One request to the bridge, with its refusals mapped to this package's errors."""
        try:
            return await self.bridge.request(op, body, timeout_s=timeout_s, **arguments)
        except BridgeRefused as refused:
            raise _KINDS.get(refused.kind, LinkError)(refused.message, refused.hint) from refused

    async def graph(self, op: str, **arguments: Any) -> dict[str, Any]:
        """One query of the graph, after discovery has settled."""
        return (await self.ask(op, settle_s=SETTLE_S, timeout_s=_REQUEST_S + SETTLE_S, **arguments)).ok

    async def endpoints(self, topic: str) -> TopicEndpoints:
        """The publishers and subscribers of a topic; empty where the graph does not know it."""
        return _endpoints(topic, await self.graph("endpoints", topic=topic))

    async def wait_for(
        self, topic: str, *, publishers: int = 0, subscribers: int = 0, timeout_s: float
    ) -> TopicEndpoints:
        """The endpoints of a topic as soon as it has that many; what there is when the time is over."""
        present = await self.endpoints(topic)
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
        return _endpoints(topic, reply.ok)

    async def suggest_topic(self, topic: str) -> str:
        """A hint for a topic that is not there."""
        known = [str(entry[0]) for entry in (await self.graph("topics"))["topics"]]
        return names.did_you_mean(topic, known, "ros2_topic_list shows what is there.")

    # ── types and values ───────────────────────────────────────────────────────────────────────────────────────

    @property
    def codec(self) -> Codec:
        """Bytes to values and back. Loaded at first use: NumPy and the type system take a moment."""
        if self._codec is None:
            from ros2_mcp.codec.cdr import Codec
            from ros2_mcp.codec.definitions import Definitions

            self._codec = Codec(Definitions())
        return self._codec

    @property
    def definitions(self) -> Definitions:
        """The definitions known so far."""
        return self.codec.definitions

    async def learn(self, *types: str) -> None:
        """Fetches the definitions of these types, with all they refer to, from the robot.

        Raises:
            UnknownInterface: if the robot's installation has no definition of one.
        """
        async with self._loading:
            unknown = sorted({names.defining_type(name) for name in types if not self.definitions.knows(name)})
            if not unknown:
                return
            answer = (await self.ask("definitions", types=unknown)).ok
            if answer["missing"]:
                raise UnknownInterface(
                    f"No definition of {', '.join(answer['missing'])} is installed where the bridge runs.",
                    await self._suggest_type(str(answer["missing"][0])),
                )
            from ros2_mcp.codec.definitions import DefinitionText

            self.definitions.add(
                {name: DefinitionText(text["format"], text["text"]) for name, text in answer["definitions"].items()}
            )

    async def _suggest_type(self, name: str) -> str:
        known: list[str] = (await self.ask("interfaces")).ok["interfaces"]
        package = name.partition("/")[0]
        if not any(other.startswith(package + "/") for other in known):
            return f"The package {package} is not there: source its workspace (--workspace DIR) or install it."
        return names.did_you_mean(name, known, "ros2_interface_list shows what is there.")

    def decode(self, type_name: str, sample: Sample) -> Message:
        """The values of a sample whose type has been learnt."""
        return self.codec.decode(type_name, sample.data)

    async def encode(self, type_name: str, value: object) -> bytes:
        """The bytes of a JSON value, strictly checked.

        Raises:
            BadValue: naming the path of what does not fit.
        """
        from ros2_mcp.codec.check import check

        await self.learn(type_name)
        return self.codec.encode(type_name, check(self.definitions, type_name, value))

    def render(self, type_name: str, body: bytes, options: RenderOptions | None = None) -> Rendered:
        """Bytes as bounded JSON values."""
        from ros2_mcp.codec.render import RenderOptions, render

        return render(
            self.definitions, type_name, self.codec.decode(type_name, body), options=options or RenderOptions()
        )

    def missing_fields(self, type_name: str, value: Mapping[str, Any]) -> list[str]:
        """Top-level fields of a learnt type that the value does not give."""
        from ros2_mcp.codec.check import missing_fields

        return missing_fields(self.definitions, type_name, value)

    def field_types(self, type_name: str) -> dict[str, Any]:
        """Name → type of the top-level fields of a learnt message type."""
        return {field.name: field.type for field in self.definitions.interface(type_name).sections[0].fields}

    # ── reading ────────────────────────────────────────────────────────────────────────────────────────────────

    @asynccontextmanager
    async def listen(
        self,
        topic: str,
        type_name: str = "",
        *,
        wait_s: float = 0.0,
        keep: str = "all",
        max_samples: int = 20_000,
        max_bytes: int = 64_000_000,
    ) -> AsyncIterator[Listening]:
        """A subscription that matches every publisher there is.

        Args:
            topic: its name; it need not be there yet.
            type_name: needed only if the topic has several types or none yet.
            wait_s: how long to wait for a first publisher.
            keep: `all` samples that wait, or only the `latest`.
            max_samples: bound on the samples that wait; the oldest are dropped and counted.
            max_bytes: bound on their bytes.

        Raises:
            NotFound: if the topic is not there and no type is given.
            TypeConflict: if it has several types and none is given, or not the given one.
        """
        topic = names.absolute(topic)
        present = await self.wait_for(topic, publishers=1, timeout_s=wait_s)
        type_name = await self.topic_type(present, type_name)
        await self.learn(type_name)
        publishers = [publisher for publisher in present.publishers if publisher.type == type_name]
        choice = qos.for_subscribing(publishers, depth=1 if keep == "latest" else 1000)
        async with await self.bridge.subscribe(
            topic, type_name, choice.qos.request(), keep=keep, max_samples=max_samples, max_bytes=max_bytes
        ) as subscription:
            yield Listening(topic, type_name, choice, publishers, subscription)

    async def topic_type(self, present: TopicEndpoints, asked: str) -> str:
        """The one type to use on a topic: the asked one, or the only one that the graph knows."""
        if asked:
            wanted = asked if names.is_derived(asked) else names.interface_type(asked, "msg")
            if present.types and wanted not in present.types:
                raise TypeConflict(
                    f"{present.topic} has the type {' and '.join(present.types)}, not {wanted}.",
                    "Leave the type out to use the one it has.",
                )
            return wanted
        if not present.types:
            raise NotFound(
                f"There is no topic {present.topic}: nobody publishes or subscribes to it.",
                await self.suggest_topic(present.topic),
            )
        if len(present.types) > 1:
            raise TypeConflict(
                f"{present.topic} has {len(present.types)} types: {', '.join(present.types)}.",
                "Give the type you mean.",
            )
        return present.types[0]

    # ── writing ────────────────────────────────────────────────────────────────────────────────────────────────

    async def publish(
        self, topic: str, type_name: str, value: object, *, wait_match_s: float, wait_ack_s: float = 2.0
    ) -> Sent:
        """Publishes one message: waits (bounded) for a subscriber to match and for its acknowledgement."""
        topic, type_name, choice, body = await self._prepare(topic, type_name, value)
        reply = await self.ask(
            "publish",
            body,
            timeout_s=wait_match_s + wait_ack_s + _REQUEST_S,
            topic=topic,
            type=type_name,
            qos=choice.qos.request(),
            wait_match_s=wait_match_s,
            wait_ack_s=wait_ack_s,
        )
        return Sent(topic, type_name, choice, 1, reply.ok["matched"], reply.ok["acked"], reply.ok["waited_s"])

    async def repeat(
        self,
        topic: str,
        type_name: str,
        value: object,
        *,
        rate_hz: float,
        duration_s: float,
        wait_match_s: float,
    ) -> Sent:
        """Publishes one message at a rate for a time; the rhythm is kept inside the bridge."""
        topic, type_name, choice, body = await self._prepare(topic, type_name, value)
        zero = await self.encode(type_name, {}) if type_name in VELOCITY_TYPES else b""
        reply = await self.ask(
            "repeat",
            body + zero,
            final_size=len(zero),
            timeout_s=duration_s + wait_match_s + _REQUEST_S,
            topic=topic,
            type=type_name,
            qos=choice.qos.request(),
            wait_match_s=wait_match_s,
            rate_hz=rate_hz,
            duration_s=duration_s,
        )
        ok = reply.ok
        return Sent(topic, type_name, choice, ok["sent"], ok["matched"], None, ok["elapsed_s"], ok["late"], bool(zero))

    async def call(
        self,
        service: str,
        service_type: str,
        request: Mapping[str, Any],
        *,
        timeout_s: float,
        wait_s: float | None = None,
    ) -> Answer:
        """Calls a service whose server may still have to appear.

        Raises:
            NotFound: if no server appeared within `wait_s` (the time-out if not given), or it left before it answered.
            TimedOut: if it did not answer in time.
        """
        body = await self.encode(f"{service_type}_Request", request)
        wait_s = timeout_s if wait_s is None else wait_s
        reply = await self.ask(
            "call",
            body,
            service=service,
            type=service_type,
            wait_s=wait_s,
            timeout_s=timeout_s,
        )
        return Answer(reply.body, reply.ok["elapsed_s"])

    async def _prepare(self, topic: str, type_name: str, value: object) -> tuple[str, str, Choice, bytes]:
        topic = names.absolute(topic)
        self.policy.require_write(f"Publishing on {topic}")
        present = await self.endpoints(topic)
        type_name = await self.topic_type(present, type_name)
        body = await self.encode(type_name, value)
        subscribers = [subscriber for subscriber in present.subscribers if subscriber.type == type_name]
        return topic, type_name, qos.for_publishing(subscribers), body


def _endpoints(topic: str, raw: Mapping[str, Any]) -> TopicEndpoints:
    return TopicEndpoints(
        topic,
        [Endpoint.parse(endpoint) for endpoint in raw["publishers"]],
        [Endpoint.parse(endpoint) for endpoint in raw["subscribers"]],
    )
