"""The bridge's end of the stream: one thread reads packets, another thread writes packets, replies before samples."""

from __future__ import annotations

import math
import os
import sys
import threading
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import NamedTuple

from ros2_mcp_bridge.request import OperationError
from ros2_mcp_common.wire.limits import BATCH_BYTES, MAX_BODY_BYTES, MOST_WAITING_BYTES, PIECE_BYTES
from ros2_mcp_common.wire.packets import Packet, PacketError, PacketReader, pack
from ros2_mcp_common.wire.pieces import LANE_OF_REQUESTS, Credit, Cut, Lanes
from ros2_mcp_common.wire.protocol import Counts, SampleHead, Samples

# As much as a pipe of the local carrier holds.
READ_BYTES = BATCH_BYTES
# The most samples in a batch that is sent in pieces: their times take about as much room as one piece.
PIECE_SAMPLES = 256


def claim_standard_streams() -> tuple[int, int]:
    """Move stdin and stdout to private descriptors, so that nothing else in this process reads or writes the stream.

    Return both descriptors. Afterwards 0 is /dev/null and 1 is stderr.
    """
    incoming, outgoing = os.dup(0), os.dup(1)  # close-on-exec, as every descriptor that Python makes
    null = os.open(os.devnull, os.O_RDONLY)
    os.dup2(null, 0)
    os.close(null)
    os.dup2(2, 1)
    return incoming, outgoing


def read_packets(
    descriptor: int,
    wait_readable: Callable[[], None] = lambda: None,
    outbox: Outbox | None = None,
) -> Iterator[Packet]:
    """Yield every packet until the stream ends.

    `wait_readable` is called before each read and returns when something can be read. With an `outbox`, pieces are
    assembled and acknowledged through it, and acknowledgements of the other side are passed to it.

    Raises:
        PacketError: if the stream breaks.
    """
    reader, lanes = PacketReader(), Lanes()
    # Read into one buffer: os.read would create an object of READ_BYTES and then shrink it. Objects created meanwhile
    # lie behind it, so each read left a hole in the heap, and the process grew by 8 MB in an hour of small requests.
    buffer = memoryview(bytearray(READ_BYTES))
    while True:
        wait_readable()
        size = os.readv(descriptor, [buffer])
        if not size:
            break
        for packet in reader.feed(bytes(buffer[:size])):
            op = packet.header.get("op")
            if outbox and op == "ack":
                outbox.acknowledge(packet.header.get("bytes"))
            elif outbox and op == "piece":
                whole = list(lanes.feed(*packet))
                outbox.send({"event": "ack", "bytes": lanes.taken_bytes})
                yield from whole
            else:
                yield packet
    if reader.is_inside_packet:
        raise PacketError("the stream ended inside a packet")


class Sample(NamedTuple):
    """One message as bytes.

    `lost` is the number of messages known to be lost up to this one, or None if it cannot be known. `whole` is the size
    of the message in bytes if `data` is only its head, else 0. Times are Unix times in ns.
    """

    received_ns: int
    source_ns: int
    sequence: int | None
    data: bytes
    lost: int | None
    whole: int = 0


class SampleQueue:
    """The samples of one subscription that wait for the stream. Its size is bounded: the
    oldest are dropped and counted.

    `cut` is the packet of samples that is being sent in pieces. `skipped` counts samples left out by `every_n`, which
    count as received. Use the queue only through the `Outbox`, which holds the lock.
    """

    def __init__(self, number: int, max_samples: float, max_bytes: float) -> None:
        self.number = number
        self.received = 0
        self.skipped = 0
        self.dropped = 0
        self.waiting: deque[Sample] = deque()
        self.cut: Cut | None = None
        self.asked: list[tuple[int | None, int | None]] = []  # (request, lost): answered after what waits
        self.bytes = 0
        self._max_samples = max_samples
        self._max_bytes = max_bytes

    def add(self, samples: Iterable[Sample]) -> None:
        """Append samples and keep within the bounds. The newest sample is kept even if it alone exceeds `max_bytes`."""
        for sample in samples:
            self.received += 1
            if len(sample.data) > MAX_BODY_BYTES:  # no packet can carry it
                self.dropped += 1
                continue
            self.waiting.append(sample)
            self.bytes += len(sample.data)
            while len(self.waiting) > 1 and (len(self.waiting) > self._max_samples or self.bytes > self._max_bytes):
                self.drop_oldest()

    def drop_oldest(self) -> None:
        """Drop the oldest waiting sample."""
        self._pop()
        self.dropped += 1

    def counts(self, lost: int | None) -> Counts:
        """Return the counts of messages so far. Samples that still wait count as received."""
        return {"received": self.received + self.skipped, "dropped": self.dropped, "lost": lost}

    @property
    def has_work(self) -> bool:
        """Whether something has yet to be written."""
        return bool(self.waiting or self.cut)

    def leave_at_most(self, most_bytes: int) -> None:
        """Drop the packet that is being sent if more than `most_bytes` bytes of it remain, and the oldest samples until
        no more than that wait.
        """
        if self.cut and self.cut.left_bytes > most_bytes:  # it is one sample: batches of several are smaller
            self.cut = None
            self.dropped += 1
        while self.waiting and self.bytes > most_bytes:
            self.drop_oldest()

    def take_batch(self, most_bytes: int = BATCH_BYTES, most_samples: float = math.inf) -> bytes:
        """Remove the oldest samples, up to so many bytes but at least one sample, and return their packet."""
        batch = [self._pop()]
        size = len(batch[0].data)
        while self.waiting and size + len(self.waiting[0].data) <= most_bytes and len(batch) < most_samples:
            batch.append(self._pop())
            size += len(batch[-1].data)
        header: Samples = {
            "event": "samples",
            "sub": self.number,
            "samples": [SampleHead(*sample[:3], len(sample.data), sample.whole) for sample in batch],
            "received": self.received + self.skipped - len(self.waiting),
            "dropped": self.dropped,
            "lost": batch[-1].lost,
        }
        return pack(header, b"".join(sample.data for sample in batch))

    def _pop(self) -> Sample:
        sample = self.waiting.popleft()
        self.bytes -= len(sample.data)
        return sample


class Outbox:
    """The packets that wait to be written: replies and events, which are never dropped, and queues of samples.
    Thread-safe.

    Over a slow link (`begin_pieces`), large packets and all samples are sent in pieces, as far as the server keeps up;
    small packets go before them.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._packets: deque[bytes] = deque()
        self._large: deque[Cut] = deque()
        self._queues: deque[SampleQueue] = deque()
        self._credit: Credit | None = None

    def begin_pieces(self, window_bytes: int) -> None:
        """Send in pieces from now on, of which about so many bytes are under way (see `Credit`); 0 has no effect. A
        second call changes nothing.
        """
        with self._changed:
            if window_bytes and self._credit is None:
                self._credit = Credit(max(window_bytes, PIECE_BYTES))

    def acknowledge(self, total: object) -> None:
        """Record that the server has taken `total` bytes of pieces in all.

        Raise `PacketError` for an impossible number.
        """
        with self._changed:
            if self._credit is None:
                raise PacketError("pieces were acknowledged that were not written")
            self._credit.acknowledge(total)
            self._changed.notify()

    def send(self, header: Mapping[str, object], body: bytes = b"") -> None:
        """Send a reply or an event. If it is too large for a packet, an error is sent instead."""
        packet = _pack(header, body)
        with self._changed:
            if self._credit is not None and "id" in header and len(packet) > self._credit.piece_bytes:
                self._large.append(Cut("event", LANE_OF_REQUESTS, packet))
            else:
                self._packets.append(packet)
            self._changed.notify()

    def reply(self, request_id: int | None, ok: Mapping[str, object], body: bytes = b"") -> None:
        """Answer a request."""
        self.send({"id": request_id, "ok": ok}, body)

    def reply_error(self, request_id: int | None, error: Exception) -> None:
        """Answer a request with an error. An unexpected error is logged, too."""
        if not isinstance(error, OperationError):
            traceback.print_exception(type(error), error, error.__traceback__, file=sys.stderr)
            error = OperationError("ros_error", f"{type(error).__name__}: {error}")
        self.send({"id": request_id, "error": error.as_json()})

    def add_samples(self, queue: SampleQueue, samples: Iterable[Sample]) -> None:
        """Append samples to their subscription's queue."""
        with self._changed:
            was_idle = not queue.has_work
            queue.add(samples)
            if was_idle and queue.waiting:
                self._queues.append(queue)
                self._changed.notify()
            while sum(each.bytes for each in self._queues) > MOST_WAITING_BYTES:
                largest = max(self._queues, key=lambda each: each.bytes)
                if len(largest.waiting) == 1:
                    break
                largest.drop_oldest()

    def reply_after_samples(
        self, queue: SampleQueue, request_id: int | None, lost: int | None, *, is_last: bool = True
    ) -> None:
        """Answer a request with the counts as soon as the queue's samples have been sent.

        Over a slow link, if `is_last`, only as much is still sent as may be under way: a caller that ends a
        subscription does not wait for more.
        """
        with self._changed:
            if self._credit is not None and is_last:
                queue.leave_at_most(self._credit.window_bytes)
                if not queue.has_work and queue in self._queues:
                    self._queues.remove(queue)
            queue.asked.append((request_id, lost))
            if not queue.has_work:
                self._answer_counts(queue)
                self._changed.notify()

    def finish(self) -> None:
        """Make `write_packets` return when it has written what waits now."""
        with self._changed:
            self._packets.append(b"")
            self._changed.notify()

    def write_packets(self, descriptor: int) -> None:
        """Write packets until `finish` is called, or the other side closes the stream."""
        try:
            while packet := self._next_packet():
                rest = memoryview(packet)
                while rest:
                    rest = rest[os.write(descriptor, rest) :]
        except OSError as error:
            sys.stderr.write(f"the stream to the server is broken: {error}\n")

    def _next_packet(self) -> bytes:
        with self._changed:
            self._changed.wait_for(self._has_something_to_write)
            if self._packets:
                return self._packets.popleft()
            if self._credit is not None and self._large:
                packet = self._piece_of(self._large[0], self._credit)
                if not self._large[0].left_bytes:
                    self._large.popleft()
                return packet
            # One packet or piece of each queue in turn, so that a flood on one topic does not delay the others.
            queue = self._queues.popleft()
            if self._credit is None:
                packet = queue.take_batch()
            else:
                batch_bytes = self._credit.piece_bytes
                queue.cut = queue.cut or Cut("event", queue.number, queue.take_batch(batch_bytes, PIECE_SAMPLES))
                packet = self._piece_of(queue.cut, self._credit)
                queue.cut = queue.cut if queue.cut.left_bytes else None
            if queue.has_work:
                self._queues.append(queue)
            else:
                self._answer_counts(queue)
            return packet

    def _answer_counts(self, queue: SampleQueue) -> None:
        """Answer the requests for counts of a queue that is empty.

        The counts are current ones: more samples may have come, and been sent, since they were requested.
        """
        self._packets.extend(_pack({"id": asked, "ok": queue.counts(lost)}, b"") for asked, lost in queue.asked)
        queue.asked.clear()

    def _has_something_to_write(self) -> bool:
        may_write_pieces = self._credit is None or self._credit.has_room
        return bool(self._packets or ((self._large or self._queues) and may_write_pieces))

    def _piece_of(self, cut: Cut, credit: Credit) -> bytes:
        packet, size = cut.take(credit.piece_bytes)
        credit.write(size)
        return packet


def _pack(header: Mapping[str, object], body: bytes) -> bytes:
    try:
        return pack(header, body)
    except PacketError as error:
        return pack({"id": header.get("id"), "error": OperationError("ros_error", str(error)).as_json()})
