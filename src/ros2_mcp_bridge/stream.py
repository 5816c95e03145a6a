"""The bridge's end of the stream: packets come in on one thread and go out on another, replies before samples."""

from __future__ import annotations

import os
import sys
import threading
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import NamedTuple

from .limits import BATCH_BYTES, MAX_BODY_BYTES
from .packets import Packet, PacketError, PacketReader, pack
from .protocol import Counts, SampleHead, Samples
from .request import OperationError

# As much as a pipe of the local carrier holds; one that holds less gives less.
READ_BYTES = BATCH_BYTES


def claim_standard_streams() -> tuple[int, int]:
    """Move stdin and stdout to private descriptors, so that nothing else in this process reads or writes the stream.

    Returns both descriptors. Afterwards 0 is /dev/null and 1 is stderr.
    """
    incoming, outgoing = os.dup(0), os.dup(1)  # close-on-exec, as every descriptor that Python makes
    null = os.open(os.devnull, os.O_RDONLY)
    os.dup2(null, 0)
    os.close(null)
    os.dup2(2, 1)
    return incoming, outgoing


def read_packets(descriptor: int, wait_readable: Callable[[], None] = lambda: None) -> Iterator[Packet]:
    """Yield every packet until the stream ends; raises `PacketError` when it breaks.

    `wait_readable` is called before each read; it returns when something can be read.
    """
    reader = PacketReader()
    while True:
        wait_readable()
        piece = os.read(descriptor, READ_BYTES)
        if not piece:
            break
        yield from reader.feed(piece)
    if reader.is_inside_packet:
        raise PacketError("the stream ended inside a packet")


class Sample(NamedTuple):
    """One message as bytes.

    `lost` is the number of messages known to be lost up to this one, or None where that cannot be known.
    """

    received_ns: int
    source_ns: int
    sequence: int | None
    data: bytes
    lost: int | None


class SampleQueue:
    """The samples of one subscription that wait for the stream: bounded, the oldest are dropped and counted.

    Use it only through the `Outbox`, which holds the lock.
    """

    def __init__(self, number: int, max_samples: float, max_bytes: float) -> None:
        self.number = number
        self.received = 0
        self.dropped = 0
        self.waiting: deque[Sample] = deque()
        self.last_packet: bytes | None = None
        self._bytes = 0
        self._max_samples = max_samples
        self._max_bytes = max_bytes

    def add(self, samples: Iterable[Sample]) -> None:
        """Append and keep the bounds; the newest sample stays even if it is larger than `max_bytes` alone."""
        for sample in samples:
            self.received += 1
            if len(sample.data) > MAX_BODY_BYTES:  # no packet can carry it
                self.dropped += 1
                continue
            self.waiting.append(sample)
            self._bytes += len(sample.data)
            while len(self.waiting) > 1 and (len(self.waiting) > self._max_samples or self._bytes > self._max_bytes):
                self._pop()
                self.dropped += 1

    def counts(self, lost: int | None) -> Counts:
        """What became of the messages so far; those that still wait count as received."""
        return {"received": self.received, "dropped": self.dropped, "lost": lost}

    def take_batch(self) -> bytes:
        """Remove the oldest samples, up to `BATCH_BYTES` or one, and return their packet."""
        batch = [self._pop()]
        size = len(batch[0].data)
        while self.waiting and size + len(self.waiting[0].data) <= BATCH_BYTES:
            batch.append(self._pop())
            size += len(batch[-1].data)
        header: Samples = {
            "event": "samples",
            "sub": self.number,
            "samples": [SampleHead(*sample[:3], len(sample.data)) for sample in batch],
            "received": self.received - len(self.waiting),
            "dropped": self.dropped,
            "lost": batch[-1].lost,
        }
        return pack(header, b"".join(sample.data for sample in batch))

    def _pop(self) -> Sample:
        sample = self.waiting.popleft()
        self._bytes -= len(sample.data)
        return sample


class Outbox:
    """What waits to be written: replies and events, which are never dropped, and queues of samples."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._packets: deque[bytes] = deque()
        self._queues: deque[SampleQueue] = deque()

    def send(self, header: Mapping[str, object], body: bytes = b"") -> None:
        """Send a reply or an event; one that no packet can carry is replaced by an error."""
        self._append(_pack(header, body))

    def reply(self, request_id: int | None, ok: Mapping[str, object], body: bytes = b"") -> None:
        """Answer a request."""
        self.send({"id": request_id, "ok": ok}, body)

    def reply_error(self, request_id: int | None, error: Exception) -> None:
        """Answer a request with what went wrong; what nobody expected is logged, too."""
        if not isinstance(error, OperationError):
            traceback.print_exception(type(error), error, error.__traceback__, file=sys.stderr)
            error = OperationError("ros_error", f"{type(error).__name__}: {error}")
        self.send({"id": request_id, "error": error.as_json()})

    def add_samples(self, queue: SampleQueue, samples: Iterable[Sample]) -> None:
        """Let samples wait in their subscription's queue."""
        with self._changed:
            was_empty = not queue.waiting
            queue.add(samples)
            if was_empty and queue.waiting:
                self._queues.append(queue)
                self._changed.notify()

    def reply_after_samples(self, queue: SampleQueue, request_id: int | None, ok: Mapping[str, object]) -> None:
        """Answer a request as soon as the queue's samples have been sent."""
        packet = _pack({"id": request_id, "ok": ok}, b"")
        with self._changed:
            if queue.waiting:
                queue.last_packet = packet
                return
        self._append(packet)

    def finish(self) -> None:
        """Let `write_packets` return when it has written what waits now."""
        self._append(b"")

    def write_packets(self, descriptor: int) -> None:
        """Write until `finish`, or until the other side closes the stream."""
        try:
            while packet := self._next_packet():
                rest = memoryview(packet)
                while rest:
                    rest = rest[os.write(descriptor, rest) :]
        except OSError as error:
            sys.stderr.write(f"the stream to the server is broken: {error}\n")

    def _append(self, packet: bytes) -> None:
        with self._changed:
            self._packets.append(packet)
            self._changed.notify()

    def _next_packet(self) -> bytes:
        with self._changed:
            self._changed.wait_for(lambda: self._packets or self._queues)
            if self._packets:
                return self._packets.popleft()
            # One packet of each queue in turn, so that a flood on one topic does not hold up the others.
            queue = self._queues.popleft()
            packet = queue.take_batch()
            if queue.waiting:
                self._queues.append(queue)
            elif queue.last_packet:
                self._packets.append(queue.last_packet)
            return packet


def _pack(header: Mapping[str, object], body: bytes) -> bytes:
    try:
        return pack(header, body)
    except PacketError as error:
        return pack({"id": header.get("id"), "error": OperationError("ros_error", str(error)).as_json()})
