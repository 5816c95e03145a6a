"""The server's end of one subscription: a bounded queue of samples, and counts of all messages."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Awaitable, Callable, Sequence
from types import TracebackType

from ros2_mcp.model.errors import LinkError
from ros2_mcp.model.samples import Counts, Sample
from ros2_mcp_common.wire.protocol import Counts as BridgeCounts
from ros2_mcp_common.wire.protocol import Keep, Samples

Unsubscribe = Callable[["Subscription"], Awaitable[None]]


def samples_of(header: Samples, body: bytes) -> list[Sample]:
    """Return the samples of a packet: times and sizes are in the header, the bytes follow each other in the body."""
    samples: list[Sample] = []
    offset = 0
    for received_ns, source_ns, sequence, size, whole_bytes in header["samples"]:
        samples.append(Sample(received_ns, source_ns, sequence, body[offset : offset + size], whole_bytes))
        offset += size
    return samples


class Subscription:
    """Samples of one topic in order of arrival. Use it as an async context manager, or call `close`."""

    def __init__(self, keep: Keep, max_samples: int, max_bytes: int, unsubscribe: Unsubscribe) -> None:
        self.number: int | None = None
        self._max_samples = 1 if keep == "latest" else max_samples
        self._max_bytes = max_bytes
        self._unsubscribe = unsubscribe
        self._waiting: deque[Sample] = deque()
        self._waiting_bytes = 0
        self._bridge_counts = Counts()
        self._dropped_here = 0
        self._arrival: asyncio.Future[None] | None = None
        self._closed = False
        self._lost: LinkError | None = None

    async def take(self, timeout_s: float) -> list[Sample]:
        """Return all waiting samples, oldest first. Wait for the first one; return an empty list after the time-out.

        Raises:
            BridgeLost: if the bridge is gone, and all samples from before have been taken.
        """
        if not self._waiting and not self._closed and not self._lost and timeout_s > 0:
            if self._arrival is None:
                self._arrival = asyncio.get_running_loop().create_future()
            await asyncio.wait({self._arrival}, timeout=timeout_s)
        if self._lost and not self._waiting:
            raise type(self._lost)(self._lost.message, self._lost.hint)
        taken = list(self._waiting)
        self._waiting.clear()
        self._waiting_bytes = 0
        return taken

    @property
    def counts(self) -> Counts:
        """The numbers of received, dropped and lost messages so far, on both sides of the stream."""
        bridge = self._bridge_counts
        return Counts(bridge.received, bridge.dropped + self._dropped_here, bridge.lost)

    async def close(self) -> Counts:
        """End the subscription; waiting samples can still be taken. Safe to call twice."""
        if not self._closed:
            self._closed = True
            self._wake()
            await self._unsubscribe(self)
        return self.counts

    async def aclose(self) -> None:
        """Do the same as `close`, for `contextlib.aclosing`."""
        await self.close()

    async def __aenter__(self) -> Subscription:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    # ── for the connection ─────────────────────────────────────────────────────────────────────────────────────

    def arrived(self, header: Samples, body: bytes) -> None:
        """Take in a packet of samples: times, sizes and totals in the header, bytes in the body."""
        self.count(header)
        self.take_in(samples_of(header, body))

    def take_in(self, samples: Sequence[Sample]) -> None:
        """Queue samples until they are taken."""
        if not samples:
            return
        self._waiting.extend(samples)
        self._waiting_bytes += sum(len(sample.data) for sample in samples)
        self._drop_oldest()
        self._wake()

    def count(self, totals: BridgeCounts) -> None:
        """Take in the bridge's present totals."""
        self._bridge_counts = Counts(totals["received"], totals["dropped"], totals["lost"])

    def lose(self, error: LinkError) -> None:
        """Take note that the bridge is gone: nothing more will arrive."""
        if not self._closed:
            self._lost = error
            self._wake()

    def _drop_oldest(self) -> None:
        """Drop samples beyond the bounds; the newest sample is kept, whatever its size."""
        while len(self._waiting) > self._max_samples or (
            self._waiting_bytes > self._max_bytes and len(self._waiting) > 1
        ):
            self._waiting_bytes -= len(self._waiting.popleft().data)
            self._dropped_here += 1

    def _wake(self) -> None:
        if self._arrival and not self._arrival.done():
            self._arrival.set_result(None)
        self._arrival = None
