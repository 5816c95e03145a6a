"""Large packets and samples cross a slow link in pieces, and small packets pass between them."""

from __future__ import annotations

import os
import threading
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from ros2_mcp_bridge.stream import Outbox, Sample, SampleQueue, read_packets
from ros2_mcp_common.wire.limits import FIRST_PIECE_BYTES, FIRST_WINDOW_BYTES, PIECE_BYTES, WINDOW_BYTES
from ros2_mcp_common.wire.packets import Packet, PacketError, PacketReader, pack
from ros2_mcp_common.wire.pieces import Cut, Lanes

PICTURE = os.urandom(20 * PIECE_BYTES)
AT_FIRST = FIRST_WINDOW_BYTES // FIRST_PIECE_BYTES
"""As many pieces are sent over a new link."""


def sample(data: bytes) -> Sample:
    return Sample(1, 2, None, data, 0)


class Slow:
    """The other end of an outbox that writes in pieces: takes packets one by one, and acknowledges when told to."""

    def __init__(self, outbox: Outbox) -> None:
        self._outbox = outbox
        self._reading, self._writing = os.pipe()
        self._reader, self._packets = PacketReader(), list[Packet]()
        self.lanes = Lanes()
        self._thread = threading.Thread(target=outbox.write_packets, args=(self._writing,))
        self._thread.start()

    def next(self) -> Packet:
        while not self._packets:
            self._packets += self._reader.feed(os.read(self._reading, 1024 * 1024))
        return self._packets.pop(0)

    def whole(self) -> Packet:
        """The next packet that is whole; every piece is acknowledged."""
        while True:
            packet = self.next()
            if packet.header.get("event") != "piece":
                return packet
            wholes = list(self.lanes.feed(*packet))
            self._outbox.acknowledge(self.lanes.taken_bytes)
            if wholes:
                return wholes[0]

    def close(self) -> None:
        self._outbox.finish()
        while self._thread.is_alive():
            self._thread.join(0.01)
        os.close(self._writing)
        os.close(self._reading)


@contextmanager
def slow() -> Generator[tuple[Outbox, Slow]]:
    outbox = Outbox()
    outbox.begin_pieces(WINDOW_BYTES)
    link = Slow(outbox)
    try:
        yield outbox, link
    finally:
        link.close()


def test_no_more_is_under_way_than_the_window_and_a_reply_passes_it() -> None:
    with slow() as (outbox, link):
        outbox.add_samples(SampleQueue(3, 10, 10_000_000), [sample(PICTURE)])
        pieces = [link.next() for _ in range(AT_FIRST)]
        assert [(piece.header["lane"], len(piece.body)) for piece in pieces] == [(3, FIRST_PIECE_BYTES)] * AT_FIRST
        outbox.reply(7, {})
        assert link.next().header == {"id": 7, "ok": {}}
        for piece in pieces:
            assert list(link.lanes.feed(*piece)) == []
        outbox.acknowledge(link.lanes.taken_bytes)
        whole = link.whole()
    assert (whole.header["event"], whole.body) == ("samples", PICTURE)


def test_a_large_reply_goes_in_pieces_too_and_before_samples() -> None:
    with slow() as (outbox, link):
        outbox.add_samples(SampleQueue(1, 10, 10_000_000), [sample(PICTURE)])
        first = link.next()
        outbox.reply(8, {"text": "x" * 3 * PIECE_BYTES})
        list(link.lanes.feed(*first))
        outbox.acknowledge(link.lanes.taken_bytes)
        assert link.whole().header["id"] == 8
        assert link.whole().body == PICTURE


def test_subscriptions_take_turns_piece_by_piece() -> None:
    with slow() as (outbox, link):
        outbox.add_samples(SampleQueue(1, 10, 10_000_000), [sample(PICTURE)])
        outbox.add_samples(SampleQueue(2, 10, 10_000_000), [sample(b"small")])
        found = [link.whole().header["sub"], link.whole().header["sub"]]
    assert found == [2, 1]


def test_who_ends_a_subscription_does_not_wait_for_pictures_that_have_not_come() -> None:
    with slow() as (outbox, link):
        queue = SampleQueue(1, 10, 10_000_000)
        outbox.add_samples(queue, [sample(PICTURE), sample(PICTURE)])
        for _ in range(AT_FIRST):
            list(link.lanes.feed(*link.next()))
        outbox.reply_after_samples(queue, 9, 0)
        assert link.next().header == {"id": 9, "ok": {"received": 2, "dropped": 2, "lost": 0}}
        queue = SampleQueue(2, 10, 10_000_000)
        outbox.add_samples(queue, [sample(b"a"), sample(b"b")])
        outbox.reply_after_samples(queue, 10, 0)
        outbox.acknowledge(link.lanes.taken_bytes)
        assert [link.whole().body, link.whole().header["id"]] == [b"ab", 10]


def test_without_a_slow_link_nothing_is_cut() -> None:
    outbox = Outbox()
    outbox.begin_pieces(0)
    link = Slow(outbox)
    outbox.add_samples(SampleQueue(1, 10, 10_000_000), [sample(PICTURE)])
    packet = link.next()
    link.close()
    assert (packet.header["event"], packet.body) == ("samples", PICTURE)


def cut(packet: bytes, lane: int = 0) -> Iterator[bytes]:
    leaving = Cut("op", lane, packet)
    while leaving.left_bytes:
        yield leaving.take()[0]


def read(*stream: bytes, outbox: Outbox) -> list[Packet]:
    reading, writing = os.pipe()

    def write() -> None:
        for piece in stream:
            os.write(writing, piece)
        os.close(writing)

    thread = threading.Thread(target=write)
    thread.start()
    try:
        return list(read_packets(reading, outbox=outbox))
    finally:
        thread.join(20)
        os.close(reading)


def test_what_comes_in_pieces_is_read_as_a_whole_and_what_is_small_before_it() -> None:
    large = pack({"id": 1, "op": "publish"}, PICTURE)
    first, *rest = cut(large)
    given_up = next(cut(pack({"id": 3}, PICTURE)))
    found = read(given_up, first, pack({"id": 2, "op": "stop"}), *rest, outbox=Outbox())
    assert [(packet.header["id"], len(packet.body)) for packet in found] == [(2, 0), (1, len(PICTURE))]


@pytest.mark.parametrize(
    ("header", "complaint"),
    [
        ({"op": "ack", "bytes": 1}, "that were not written"),
        ({"op": "piece", "lane": "0"}, "of the lane '0'"),
    ],
)
def test_what_is_no_piece_and_what_acknowledges_none_breaks_the_stream(header: dict[str, Any], complaint: str) -> None:
    with pytest.raises(PacketError, match=complaint):
        read(pack(header, b"x"), outbox=Outbox())


def test_more_than_was_written_cannot_be_acknowledged() -> None:
    outbox = Outbox()
    outbox.begin_pieces(WINDOW_BYTES)
    with pytest.raises(PacketError, match="of 0 that were written"):
        outbox.acknowledge(1)


def test_pieces_of_pieces_are_none() -> None:
    inner = next(cut(pack({"id": 1}, PICTURE)))
    with pytest.raises(PacketError, match="is cut into pieces"):
        read(*cut(inner), outbox=Outbox())
