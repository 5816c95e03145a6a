"""A network between ssh and sshd, in user space: it delays, loses, is narrow, and can be cut without a word."""

from __future__ import annotations

import asyncio
import random
import threading
import time
from collections import deque
from collections.abc import Generator
from contextlib import contextmanager, suppress

_SEGMENT_BYTES = 1448
# What the kernels and the radio between hold of one direction before the sender is held up. Chosen.
_IN_FLIGHT_BYTES = 256 * 1024
_READ_BYTES = 16 * 1024


class NetworkLink:
    """TCP connections to `port` go to another port of this machine, as over a bad network.

    `delay_s` is one way; `bytes_per_s` holds for each way, 0 is without bound. Of all segments the share `loss` is
    lost: as TCP does, what comes behind waits until the lost one was sent again, after at least 0.2 s. While it is cut
    nothing passes: no byte, no end of a connection, no answer to a new one.
    """

    def __init__(self, target: int, *, delay_s: float = 0.0, bytes_per_s: float = 0.0, loss: float = 0.0) -> None:
        self.port = 0
        self.delay_s, self.bytes_per_s, self.loss = delay_s, bytes_per_s, loss
        self._target = target
        self._loop = asyncio.new_event_loop()
        self._is_whole = asyncio.Event()
        self._tasks: set[asyncio.Task[None]] = set()
        self._writers: list[asyncio.StreamWriter] = []
        self._random = random.Random(1)
        self._listens = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def cut(self) -> float:
        """Nothing passes any more; returns since when (CLOCK_MONOTONIC, s)."""
        self._call(self._is_whole.clear)
        return time.monotonic()

    def mend(self) -> float:
        """Everything passes again, what was under way first; returns since when (CLOCK_MONOTONIC, s)."""
        self._call(self._is_whole.set)
        return time.monotonic()

    def start(self) -> None:
        """Listens from now on."""
        self._thread.start()
        self._listens.wait()

    def close(self) -> None:
        """Ends every connection, and itself."""
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()

    def _call(self, function: object) -> None:
        done = threading.Event()

        def call() -> None:
            assert callable(function)
            function()
            done.set()

        self._loop.call_soon_threadsafe(call)
        done.wait()

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        self._is_whole.set()
        server = self._loop.run_until_complete(asyncio.start_server(self._accept, "127.0.0.1", 0))
        self.port = server.sockets[0].getsockname()[1]
        self._listens.set()
        self._loop.run_forever()
        server.close()
        for writer in self._writers:
            writer.transport.abort()
        tasks = asyncio.all_tasks(self._loop)
        for task in tasks:
            task.cancel()
        self._loop.run_until_complete(asyncio.gather(*tasks, return_exceptions=True))
        self._loop.run_until_complete(asyncio.sleep(0))  # in which the connections are taken down
        self._loop.close()

    async def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._writers.append(writer)
        await self._is_whole.wait()
        try:
            far_reader, far_writer = await asyncio.open_connection("127.0.0.1", self._target)
        except OSError:
            writer.close()
            return
        self._writers.append(far_writer)
        for source, sink in ((reader, far_writer), (far_reader, writer)):
            task = asyncio.ensure_future(_Way(self, source, sink).carry())
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def pass_on(self, size: int) -> None:
        """Returns when so many bytes may leave."""
        if self.bytes_per_s:
            await asyncio.sleep(size / self.bytes_per_s)
        await self._is_whole.wait()

    def late_s(self, size: int) -> float:
        """By how much so many bytes come later because of what was lost of them."""
        segments = -(-size // _SEGMENT_BYTES)
        lost = sum(self._random.random() < self.loss for _ in range(segments))
        return lost * max(0.2, 3 * self.delay_s)


class _Way:
    """One direction of one connection."""

    def __init__(self, link: NetworkLink, source: asyncio.StreamReader, sink: asyncio.StreamWriter) -> None:
        self._link, self._source, self._sink = link, source, sink
        self._waiting: deque[tuple[float, bytes]] = deque()
        self._size = 0
        self._changed = asyncio.Event()

    async def carry(self) -> None:
        delivering = asyncio.ensure_future(self._deliver())
        try:
            while True:
                data = b""
                with suppress(ConnectionError):
                    data = await self._source.read(_READ_BYTES)
                while self._size > _IN_FLIGHT_BYTES:
                    self._changed.clear()
                    await self._changed.wait()
                self._waiting.append((time.monotonic() + self._link.delay_s + self._link.late_s(len(data)), data))
                self._size += len(data)
                self._changed.set()
                if not data:
                    break
            await delivering
        finally:
            delivering.cancel()

    async def _deliver(self) -> None:
        while True:
            while not self._waiting:
                self._changed.clear()
                await self._changed.wait()
            due, data = self._waiting[0]
            await asyncio.sleep(max(0.0, due - time.monotonic()))
            await self._link.pass_on(len(data))
            self._waiting.popleft()
            self._size -= len(data)
            self._changed.set()
            if not data:
                self._sink.close()
                return
            with suppress(ConnectionError):
                self._sink.write(data)
                await self._sink.drain()


@contextmanager
def network_link(
    target: int, *, delay_s: float = 0.0, bytes_per_s: float = 0.0, loss: float = 0.0
) -> Generator[NetworkLink, None, None]:
    """A link for the time of a block."""
    link = NetworkLink(target, delay_s=delay_s, bytes_per_s=bytes_per_s, loss=loss)
    link.start()
    try:
        yield link
    finally:
        link.close()
