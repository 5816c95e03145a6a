"""Pipes of a child process with one thread each, for event loops that cannot wait for pipes, as on Windows."""

from __future__ import annotations

import asyncio
import os
import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import IO, Any

# The usual size of a pipe.
_READ_BYTES = 65_536
# The most pieces that were read and not processed, 4 MB: a late event loop must not fill the memory.
_MOST_PIECES = 64


class ThreadedReader(asyncio.ReadTransport):
    """Passes on the bytes from a pipe, then its end, once."""

    def __init__(self, pipe: IO[bytes], protocol: asyncio.Protocol) -> None:
        super().__init__()
        self._pipe = pipe
        self._protocol = protocol
        self._loop = asyncio.get_running_loop()
        self._room = threading.Semaphore(_MOST_PIECES)
        self._is_closing = False
        threading.Thread(target=self._read_all, name="reader of a child", daemon=True).start()

    def is_closing(self) -> bool:
        """Return whether nothing is passed on any more."""
        return self._is_closing

    def close(self) -> None:
        """Pass on nothing more; the pipe is closed when its other end is."""
        if not self._is_closing:
            self._is_closing = True
            self._loop.call_soon(self._protocol.connection_lost, None)

    def _read_all(self) -> None:
        with self._pipe, suppress(OSError):
            while data := os.read(self._pipe.fileno(), _READ_BYTES):
                self._room.acquire()
                _tell(self._loop, self._take, data)
        _tell(self._loop, self.close)

    def _take(self, data: bytes) -> None:
        self._room.release()
        if not self._is_closing:
            self._protocol.data_received(data)


class ThreadedWriter(asyncio.WriteTransport):
    """Writes to a pipe in order. The protocol is told to pause while more than `high_bytes` wait."""

    def __init__(self, pipe: IO[bytes], protocol: asyncio.Protocol, high_bytes: int) -> None:
        super().__init__()
        self._pipe = pipe
        self._protocol = protocol
        self._high_bytes = high_bytes
        self._loop = asyncio.get_running_loop()
        self._news = threading.Condition()
        self._waiting: deque[bytes] = deque()
        self._waiting_bytes = 0
        self._is_paused = False
        self._is_closing = False
        threading.Thread(target=self._write_all, name="writer to a child", daemon=True).start()

    def write(self, data: bytes | bytearray | memoryview) -> None:
        """Queue bytes."""
        if self._is_closing:
            return
        with self._news:
            self._waiting.append(bytes(data))
            self._waiting_bytes += len(data)
            self._news.notify()
        if self._waiting_bytes > self._high_bytes and not self._is_paused:
            self._is_paused = True
            self._protocol.pause_writing()

    def get_write_buffer_size(self) -> int:
        """Return how many bytes wait."""
        return self._waiting_bytes

    def is_closing(self) -> bool:
        """Return whether no further bytes are accepted."""
        return self._is_closing

    def close(self) -> None:
        """Accept no further bytes; the pipe is closed once the waiting bytes are written."""
        with self._news:
            self._is_closing = True
            self._news.notify()

    def abort(self) -> None:
        """Close the pipe, and discard the waiting bytes."""
        with self._news:
            self._waiting.clear()
            self._waiting_bytes = 0
        self.close()

    def _write_all(self) -> None:
        with suppress(OSError), self._pipe:  # closing may fail as writing does: there is no reader any more
            while (data := self._next()) is not None:
                rest = memoryview(data)
                while rest:
                    rest = rest[os.write(self._pipe.fileno(), rest) :]
                _tell(self._loop, self._note_written, len(data))
        self.abort()
        _tell(self._loop, self._protocol.connection_lost, None)

    def _next(self) -> bytes | None:
        """Return the next bytes to write; None at the end."""
        with self._news:
            self._news.wait_for(lambda: self._waiting or self._is_closing)
            return self._waiting.popleft() if self._waiting else None

    def _note_written(self, count: int) -> None:
        with self._news:
            self._waiting_bytes = max(self._waiting_bytes - count, 0)
        if self._is_paused and self._waiting_bytes <= self._high_bytes // 2:
            self._is_paused = False
            self._protocol.resume_writing()


def _tell(loop: asyncio.AbstractEventLoop, do: Callable[..., Any], *args: Any) -> None:
    with suppress(RuntimeError):  # the loop has ended
        loop.call_soon_threadsafe(do, *args)
