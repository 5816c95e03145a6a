"""A subscription with what is known about it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

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
