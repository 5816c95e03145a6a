"""What passes through the door: endpoints of topics, subscriptions, what became of a publication or a call."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ros2_mcp.model.qos import Choice, Endpoint
from ros2_mcp.model.samples import Counts, Sample

if TYPE_CHECKING:
    from ros2_mcp.link.client import Subscription


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
    ended_early: bool = False


@dataclass(frozen=True, slots=True)
class Outgoing:
    """A checked and encoded message with its destination; `zero` is what stops a robot that such messages drive."""

    topic: str
    type: str
    choice: Choice
    body: bytes
    zero: bytes

    def destination(self) -> dict[str, Any]:
        """The arguments that the bridge's publishing operations take."""
        return {"topic": self.topic, "type": self.type, "qos": self.choice.qos.request()}


@dataclass(frozen=True, slots=True)
class Answer:
    """The response of a service as CDR bytes, and how long it took."""

    body: bytes
    elapsed_s: float
