"""A subscription as operations use it: its parameters, its samples, and its counts."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Coroutine, Sequence
from dataclasses import dataclass
from time import monotonic
from typing import TYPE_CHECKING, Any, TypeVar

import anyio

from ros2_mcp.model.graph import TopicEndpoints
from ros2_mcp.model.qos import Choice, Endpoint, still_fits
from ros2_mcp.model.samples import Counts, Sample

if TYPE_CHECKING:
    from ros2_mcp.link.client import Subscription

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Listening:
    """A subscription: topic, type, QoS, and the publishers at its start. `opened_ns` is the time of the request by the
    robot's clock, in ns.
    """

    topic: str
    type: str
    choice: Choice
    publishers: Sequence[Endpoint]
    _subscription: Subscription
    opened_ns: int = 0

    def is_from_before(self, sample: Sample) -> bool:
        """Return whether a sample was published before the subscription (by its publisher's clock), and is latched."""
        return self.choice.qos.durability == "transient_local" and 0 < sample.source_ns < self.opened_ns

    async def take(self, timeout_s: float) -> list[Sample]:
        """Return the waiting samples. Wait for the first one; return an empty list after the time-out."""
        return await self._subscription.take(timeout_s)

    async def end(self) -> None:
        """Unsubscribe. Samples that have arrived can still be taken, and the counts are final."""
        await self._subscription.close()

    async def samples(self, duration_s: float) -> AsyncIterator[Sample]:
        """Yield samples as they arrive, for `duration_s` seconds."""
        ends_at = monotonic() + duration_s
        while (left_s := ends_at - monotonic()) > 0:
            for sample in await self.take(left_s):
                yield sample

    def still_fits(self, present: TopicEndpoints) -> bool:
        """Return whether the QoS would be chosen again for the present publishers; also if there are none any more."""
        return still_fits(
            self.choice.qos, [publisher for publisher in present.publishers if publisher.type == self.type]
        )

    @property
    def counts(self) -> Counts:
        """The numbers of received, dropped and lost messages so far."""
        return self._subscription.counts


async def subscribed_while(subscribe: Coroutine[Any, Any, Subscription], other: Awaitable[T]) -> tuple[Subscription, T]:
    """Subscribe and await `other` concurrently, in one round trip; return both results.

    If one fails or this is cancelled, no subscription is left behind.
    """
    subscribing = asyncio.create_task(subscribe)
    try:
        result = await other
        return await subscribing, result
    except BaseException:  # any error is raised again
        subscribing.cancel()  # the link then withdraws a request in progress
        with anyio.CancelScope(shield=True):  # a cancelled scope cancels every await again
            await asyncio.wait({subscribing})
            if not subscribing.cancelled() and not subscribing.exception():
                await subscribing.result().close()
        raise
