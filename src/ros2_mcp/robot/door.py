"""The one door: reading, publishing and calling, by name and value."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Mapping
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Any

from ros2_mcp.guard.policy import Policy
from ros2_mcp.guard.relays import Relays
from ros2_mcp.guard.running import Driven, SentGoals
from ros2_mcp.model import names, qos
from ros2_mcp.model.commands import LOCAL
from ros2_mcp.model.errors import TypeConflict
from ros2_mcp.model.goals import CANCEL_TYPE, cancel_request
from ros2_mcp.model.graph import TopicEndpoints
from ros2_mcp.robot.exchange import Answer, Listening, Outgoing, Sent
from ros2_mcp.robot.graph import REQUEST_S, Graph
from ros2_mcp.robot.jobs import Jobs
from ros2_mcp.robot.log import LogRing
from ros2_mcp.robot.values import Values
from ros2_mcp.robot.wills import Will, Wills

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
_APPEARING_S = 1.0
"""How long a publication without a type waits for a topic that is just coming up."""


class Robot:
    """One robot: its graph, its definitions, its topics and services."""

    def __init__(self, bridge: Bridge, policy: Policy | None = None, result_bytes: int = 32_000) -> None:
        self.bridge = bridge
        self.result_bytes = result_bytes
        self.policy = policy or Policy()
        self.graph = Graph(bridge)
        self.values = Values(self.graph)
        self.wills = Wills(self.graph)
        self.limitations: list[str] = []
        self.goals = SentGoals()
        self.driven = Driven()
        self.service_types: dict[str, str] = {}
        self.relays = Relays()
        self.jobs = Jobs()
        self.principal = LOCAL
        self.log = LogRing(bridge)

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
    ) -> AsyncGenerator[Listening, None]:
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

    @asynccontextmanager
    async def listen_again(self, former: Listening, *, max_bytes: int) -> AsyncGenerator[Listening, None]:
        """The same subscription anew, at once: the bridge that follows a lost one need not look around first."""
        request = former.choice.qos.request()
        async with await self.bridge.subscribe(
            former.topic, former.type, request, keep="all", max_samples=20_000, max_bytes=max_bytes
        ) as subscription:
            yield Listening(former.topic, former.type, former.choice, former.publishers, subscription)

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
            raise await self.graph.no_such_topic(present.topic)
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
        message = await self._prepare(topic, type_name, value)
        reply = await self.graph.ask(
            "publish",
            message.body,
            timeout_s=wait_match_s + wait_ack_s + REQUEST_S,
            wait_match_s=wait_match_s,
            wait_ack_s=wait_ack_s,
            **message.destination(),
        )
        ok = reply.ok
        return Sent(message.topic, message.type, message.choice, 1, ok["matched"], ok["acked"], ok["waited_s"])

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
        message = await self._prepare(topic, type_name, value)
        reply = await self.graph.ask(
            "repeat",
            message.body + message.zero,
            timeout_s=duration_s + wait_match_s + REQUEST_S,
            final_size=len(message.zero),
            wait_match_s=wait_match_s,
            rate_hz=rate_hz,
            duration_s=duration_s,
            **message.destination(),
        )
        ok = reply.ok
        return Sent(
            message.topic,
            message.type,
            message.choice,
            ok["sent"],
            ok["matched"],
            None,
            ok["elapsed_s"],
            ok["late"],
            ok["final_sent"],
            ok["cancelled"],
        )

    async def call(
        self,
        service: str,
        service_type: str,
        request: Mapping[str, Any],
        *,
        timeout_s: float,
        wait_s: float | None = None,
    ) -> Answer:
        """Commands a service whose server may still have to appear.

        Raises:
            Refused: if this server is read-only.
            NotFound: if no server appeared within `wait_s`, or it left before it answered. Without `wait_s`, the
                time-out holds for both together.
            TimedOut: if it did not answer in time.
        """
        self.policy.require_write(f"Calling {service}")
        return await self.inquire(service, service_type, request, timeout_s=timeout_s, wait_s=wait_s)

    async def inquire(
        self,
        service: str,
        service_type: str,
        request: Mapping[str, Any],
        *,
        timeout_s: float,
        wait_s: float | None = None,
    ) -> Answer:
        """Calls a service that only tells something, such as `get_parameters`; otherwise as `call`."""
        body = await self.values.encode(f"{service_type}_Request", request)
        within_s = timeout_s if wait_s is None else wait_s + timeout_s
        wait_s = timeout_s if wait_s is None else wait_s
        reply = await self.graph.ask(
            "call",
            body,
            service=service,
            type=service_type,
            wait_s=wait_s,
            timeout_s=timeout_s,
            within_s=within_s,
        )
        return Answer(reply.body, reply.ok["elapsed_s"])

    def goal_sent(self, goal_id: str, action: str, action_type: str) -> None:
        """Notes a goal just before it is sent: the bridge cancels it if this process dies."""
        self.goals.sent(goal_id, action, action_type)
        body = self.values.encode_known(f"{CANCEL_TYPE}_Request", cancel_request(goal_id))
        service = {"service": f"{action}/_action/cancel_goal", "type": CANCEL_TYPE}
        self.wills.leave(goal_id, Will("failsafe_call", body, service))

    def goal_ended(self, goal_id: str) -> None:
        """Forgets a goal that has ended or was not accepted."""
        self.goals.ended(goal_id)
        self.wills.withdraw(goal_id)

    async def _prepare(self, topic: str, type_name: str, value: object) -> Outgoing:
        topic = names.absolute(topic)
        self.policy.require_write(f"Publishing on {topic}")
        present = await self.graph.endpoints(topic)
        if not (type_name or present.types):
            present = await self.graph.wait_for(topic, subscribers=1, timeout_s=_APPEARING_S)
        type_name = await self.topic_type(present, type_name)
        body = await self.values.encode(type_name, value)
        subscribers = [subscriber for subscriber in present.subscribers if subscriber.type == type_name]
        zero = self.values.encode_known(type_name, {}) if type_name in VELOCITY_TYPES else b""
        message = Outgoing(topic, type_name, qos.for_publishing(subscribers), body, zero)
        if zero:
            self.driven.drove(topic, type_name, zero)
            self.wills.leave(topic, Will("failsafe_publish", zero, message.destination()))
        return message
