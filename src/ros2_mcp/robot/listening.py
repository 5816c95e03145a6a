"""A subscription as operations use it: what it was made for, its samples, and what became of them."""

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
    """A subscription: its topic and type, the QoS it was made with, and the publishers of that time. `opened_ns` is
    when it was asked for, by the robot's clock.
    """

    topic: str
    type: str
    choice: Choice
    publishers: Sequence[Endpoint]
    _subscription: Subscription
    opened_ns: int = 0

    def is_from_before(self, sample: Sample) -> bool:
        """Whether it was sent before, by its publisher's clock, and came only because it is latched."""
        return self.choice.qos.durability == "transient_local" and 0 < sample.source_ns < self.opened_ns

    async def take(self, timeout_s: float) -> list[Sample]:
        """The samples that wait; waits for the first one, returns an empty list when none came in time."""
        return await self._subscription.take(timeout_s)

    async def end(self) -> None:
        """Nothing more is wanted; what had come by then can still be taken, and the counts are the last ones."""
        await self._subscription.close()

    async def samples(self, duration_s: float) -> AsyncIterator[Sample]:
        """The samples of that time, one by one as they come."""
        ends_at = monotonic() + duration_s
        while (left_s := ends_at - monotonic()) > 0:
            for sample in await self.take(left_s):
                yield sample

    def still_fits(self, present: TopicEndpoints) -> bool:
        """Whether the topic would be subscribed to in the same way now; also where nobody publishes on it any more."""
        return still_fits(
            self.choice.qos, [publisher for publisher in present.publishers if publisher.type == self.type]
        )

    @property
    def counts(self) -> Counts:
        """What became of the messages so far."""
        return self._subscription.counts


async def subscribed_while(subscribe: Coroutine[Any, Any, Subscription], other: Awaitable[T]) -> tuple[Subscription, T]:
    """Both at the same time, in one round trip; no subscription is left behind if one fails or this is cancelled."""
    subscribing = asyncio.create_task(subscribe)
    try:
        result = await other
        return await subscribing, result
    except BaseException:  # whatever it is, it is raised again
        subscribing.cancel()  # the link then takes back what is under way
        with anyio.CancelScope(shield=True):  # a scope that is cancelled cancels every await again
            await asyncio.wait({subscribing})
            if not subscribing.cancelled() and not subscribing.exception():
                await subscribing.result().close()
        raise
