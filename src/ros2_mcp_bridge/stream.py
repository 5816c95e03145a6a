# pyright: basic
"""The bridge's end of the stream: packets come in on one thread and go out on another, replies before samples."""

from __future__ import annotations

import os
import sys
import threading
import traceback
from collections import deque

from .limits import BATCH_BYTES, MAX_BODY_BYTES
from .packets import PacketError, PacketReader, pack
from .request import OperationError

# As much as a pipe of the local carrier holds; a pipe that holds less gives less.
READ_BYTES = 1024 * 1024


def claim_standard_streams():
    """Move stdin and stdout to private descriptors, so that nothing else in this process reads or writes the stream.

    Returns both descriptors. Afterwards 0 is /dev/null and 1 is stderr.
    """
    incoming, outgoing = os.dup(0), os.dup(1)  # close-on-exec, as every descriptor that Python makes
    null = os.open(os.devnull, os.O_RDONLY)
    os.dup2(null, 0)
    os.close(null)
    os.dup2(2, 1)
    return incoming, outgoing


def read_packets(descriptor):
    """Yield every packet until the stream ends; raises `PacketError` when it breaks."""
    reader = PacketReader()
    while piece := os.read(descriptor, READ_BYTES):
        yield from reader.feed(piece)
    if reader.is_inside_packet:
        raise PacketError("the stream ended inside a packet")


class SampleQueue:
    """The samples of one subscription that wait for the stream: bounded, the oldest are dropped and counted.

    A sample is the tuple (received_ns, source_ns, sequence or None, data, lost), where `lost` is the number of
    messages known to be lost up to this one, or None. Use it only through the `Outbox`, which holds the lock.
    """

    def __init__(self, number, max_samples, max_bytes):
        self.number = number
        self.received = 0
        self.dropped = 0
        self.waiting = deque()
        self.last_packet = None
        self._bytes = 0
        self._max_samples = max_samples
        self._max_bytes = max_bytes

    def add(self, samples):
        """Append and keep the bounds; the newest sample stays even if it is larger than `max_bytes` alone."""
        for sample in samples:
            self.received += 1
            if len(sample[3]) > MAX_BODY_BYTES:  # no packet can carry it
                self.dropped += 1
                continue
            self.waiting.append(sample)
            self._bytes += len(sample[3])
            while len(self.waiting) > 1 and (len(self.waiting) > self._max_samples or self._bytes > self._max_bytes):
                self._pop()
                self.dropped += 1

    def take_batch(self):
        """Remove the oldest samples, up to `BATCH_BYTES` or one, and return their packet."""
        batch = [self._pop()]
        size = len(batch[0][3])
        while self.waiting and size + len(self.waiting[0][3]) <= BATCH_BYTES:
            batch.append(self._pop())
            size += len(batch[-1][3])
        header = {
            "event": "samples",
            "sub": self.number,
            "samples": [[*sample[:3], len(sample[3])] for sample in batch],
            "received": self.received - len(self.waiting),
            "dropped": self.dropped,
            "lost": batch[-1][4],
        }
        return pack(header, b"".join(sample[3] for sample in batch))

    def _pop(self):
        sample = self.waiting.popleft()
        self._bytes -= len(sample[3])
        return sample


class Outbox:
    """What waits to be written: replies and events, which are never dropped, and queues of samples."""

    def __init__(self):
        self._changed = threading.Condition()
        self._packets = deque()
        self._queues = deque()

    def send(self, header, body=b""):
        """Send a reply or an event; one that no packet can carry is replaced by an error."""
        self._append(_pack(header, body))

    def reply(self, request_id, ok, body=b""):
        """Answer a request."""
        self.send({"id": request_id, "ok": ok}, body)

    def reply_error(self, request_id, error):
        """Answer a request with what went wrong; what nobody expected is logged, too."""
        if not isinstance(error, OperationError):
            traceback.print_exception(type(error), error, error.__traceback__, file=sys.stderr)
            error = OperationError("ros_error", f"{type(error).__name__}: {error}")
        self.send({"id": request_id, "error": error.as_json()})

    def add_samples(self, queue, samples):
        """Let samples wait in their subscription's queue."""
        with self._changed:
            was_empty = not queue.waiting
            queue.add(samples)
            if was_empty and queue.waiting:
                self._queues.append(queue)
                self._changed.notify()

    def reply_after_samples(self, queue, request_id, ok):
        """Answer a request as soon as the queue's samples have been sent."""
        packet = _pack({"id": request_id, "ok": ok}, b"")
        with self._changed:
            if queue.waiting:
                queue.last_packet = packet
                return
        self._append(packet)

    def finish(self):
        """Let `write_packets` return when it has written what waits now."""
        self._append(b"")

    def write_packets(self, descriptor):
        """Write until `finish`, or until the other side closes the stream."""
        try:
            while packet := self._next_packet():
                rest = memoryview(packet)
                while rest:
                    rest = rest[os.write(descriptor, rest) :]
        except OSError as error:
            sys.stderr.write(f"the stream to the server is broken: {error}\n")

    def _append(self, packet):
        with self._changed:
            self._packets.append(packet)
            self._changed.notify()

    def _next_packet(self):
        with self._changed:
            self._changed.wait_for(lambda: self._packets or self._queues)
            if self._packets:
                return self._packets.popleft()
            queue = self._queues.popleft()
            packet = queue.take_batch()
            if queue.waiting:
                self._queues.append(queue)
            elif queue.last_packet:
                self._packets.append(queue.last_packet)
            return packet


def _pack(header, body):
    try:
        return pack(header, body)
    except PacketError as error:
        return pack({"id": header.get("id"), "error": OperationError("ros_error", str(error)).as_json()})
