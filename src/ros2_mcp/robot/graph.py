"""Questions to the robot's graph, and the mapping of the bridge's refusals to this package's errors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from ros2_mcp.model import names
from ros2_mcp.model.errors import (
    BridgeRefused,
    LinkError,
    NotFound,
    RobotError,
    TimedOut,
    UnknownInterface,
)
from ros2_mcp.model.qos import Endpoint
from ros2_mcp.robot.exchange import TopicEndpoints

if TYPE_CHECKING:
    from ros2_mcp.link.client import Bridge, Reply

SETTLE_S = 4.0
"""A little longer than the bridge needs to be sure that nobody else is there."""
REQUEST_S = 10.0
_KINDS: Mapping[str, type[RobotError]] = {
    "unknown_type": UnknownInterface,
    "not_found": NotFound,
    "timeout": TimedOut,
    "server_gone": NotFound,
}


class Graph:
    """The graph as the bridge sees it."""

    def __init__(self, bridge: Bridge) -> None:
        self._bridge = bridge

    @property
    def is_closed(self) -> bool:
        """Whether the link to the robot was closed by us."""
        return self._bridge.is_closed

    async def ask(self, op: str, body: bytes = b"", *, timeout_s: float = REQUEST_S, **arguments: Any) -> Reply:
        """One request to the bridge, with its refusals mapped to this package's errors."""
        try:
            return await self._bridge.request(op, body, timeout_s=timeout_s, **arguments)
        except BridgeRefused as refused:
            raise _KINDS.get(refused.kind, LinkError)(refused.message, refused.hint) from refused

    async def query(self, op: str, **arguments: Any) -> Mapping[str, Any]:
        """One query of the graph, after discovery has settled."""
        return (await self.ask(op, settle_s=SETTLE_S, timeout_s=REQUEST_S + SETTLE_S, **arguments)).ok

    async def endpoints(self, topic: str) -> TopicEndpoints:
        """The publishers and subscribers of a topic; empty where the graph does not know it."""
        return _endpoints(topic, await self.query("endpoints", topic=topic))

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

    async def no_such_topic(self, topic: str) -> NotFound:
        """The error for a topic that is not there, or not seen yet, with the nearest right spelling."""
        found = await self.query("topics")
        if not found["settled"]:
            return NotFound(f"{topic} is not seen yet, but discovery is still under way.", "Ask again in a moment.")
        known = [str(entry[0]) for entry in found["topics"]]
        return NotFound(
            f"There is no topic {topic}: nobody publishes or subscribes to it.",
            names.did_you_mean(topic, known, "ros2_topic_list shows what is there."),
        )


def _endpoints(topic: str, raw: Mapping[str, Any]) -> TopicEndpoints:
    return TopicEndpoints(
        topic,
        [Endpoint.parse(endpoint) for endpoint in raw["publishers"]],
        [Endpoint.parse(endpoint) for endpoint in raw["subscribers"]],
    )
