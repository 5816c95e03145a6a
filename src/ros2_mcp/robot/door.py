"""The one door: reading, publishing and calling, by name and value."""

from __future__ import annotations

from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Any

from ros2_mcp.guard.policy import Policy
from ros2_mcp.guard.running import SentGoals
from ros2_mcp.model import names, qos
from ros2_mcp.model.errors import NotFound, TypeConflict
from ros2_mcp.model.qos import Choice
from ros2_mcp.robot.exchange import Answer, Listening, Sent, TopicEndpoints
from ros2_mcp.robot.graph import REQUEST_S, Graph
from ros2_mcp.robot.values import Values

if TYPE_CHECKING:
    from ros2_mcp.link.client import Bridge

VELOCITY_TYPES = frozenset(
    {
        "geometry_msgs/msg/Twist",
        "geometry_msgs/msg/TwistStamped",
        "ackermann_msgs/msg/AckermannDrive",
        "ackermann_msgs/msg/AckermannDriveStamped",
    }
)
"""Types whose messages keep a robot moving, and whose default value stops it."""


class Robot:
    """One robot: its graph, its definitions, its topics and services."""

    def __init__(self, bridge: Bridge, policy: Policy | None = None) -> None:
        self.bridge = bridge
        self.policy = policy or Policy()
        self.graph = Graph(bridge)
        self.values = Values(self.graph)
        self.goals = SentGoals()

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
        present = await self.graph.wait_for(topic, publishers=1, timeout_s=wait_s)
        type_name = await self.topic_type(present, type_name)
        await self.values.learn(type_name)
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
                await self.graph.suggest_topic(present.topic),
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
        reply = await self.graph.ask(
            "publish",
            body,
            timeout_s=wait_match_s + wait_ack_s + REQUEST_S,
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
        zero = await self.values.encode(type_name, {}) if type_name in VELOCITY_TYPES else b""
        reply = await self.graph.ask(
            "repeat",
            body + zero,
            final_size=len(zero),
            timeout_s=duration_s + wait_match_s + REQUEST_S,
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
        body = await self.values.encode(f"{service_type}_Request", request)
        wait_s = timeout_s if wait_s is None else wait_s
        reply = await self.graph.ask(
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
        present = await self.graph.endpoints(topic)
        type_name = await self.topic_type(present, type_name)
        body = await self.values.encode(type_name, value)
        subscribers = [subscriber for subscriber in present.subscribers if subscriber.type == type_name]
        return topic, type_name, qos.for_publishing(subscribers), body
