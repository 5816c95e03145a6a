"""The bridge's end of the stream: what is never dropped, what is, and in which order it is written."""

from __future__ import annotations

import os
import threading
from collections.abc import Sequence

import pytest

from ros2_mcp_bridge import stream
from ros2_mcp_bridge.request import OperationError
from ros2_mcp_bridge.stream import Outbox, Sample, SampleQueue, read_packets
from ros2_mcp_common.wire.limits import BATCH_BYTES
from ros2_mcp_common.wire.packets import Packet, PacketError, PacketReader, pack


def samples_of(*data: bytes) -> list[Sample]:
    return [Sample(number, 0, None, piece, 0) for number, piece in enumerate(data)]


def written(outbox: Outbox) -> list[Packet]:
    """What the outbox writes until it has nothing more."""
    outbox.finish()
    reading, writing = os.pipe()
    found = list[Packet]()

    def read() -> None:
        found.extend(read_packets(reading))

    thread = threading.Thread(target=read)
    thread.start()
    outbox.write_packets(writing)
    os.close(writing)
    thread.join(20)
    os.close(reading)
    return found


def drained(queue: SampleQueue) -> tuple[list[bytes], dict[str, object]]:
    """The data of all samples that wait, and the header of the last packet."""
    data, header = list[bytes](), dict[str, object]()
    while queue.waiting:
        (packet,) = PacketReader().feed(queue.take_batch())
        header, rest = packet.header, packet.body
        for _, _, _, size, _ in packet.header["samples"]:
            data.append(rest[:size])
            rest = rest[size:]
        assert rest == b""
    return data, header


def test_the_oldest_samples_give_way_and_each_is_counted() -> None:
    queue = SampleQueue(3, max_samples=2, max_bytes=1000)
    queue.add(samples_of(b"a", b"b", b"c"))
    data, header = drained(queue)
    assert data == [b"b", b"c"]
    assert (header["sub"], header["received"], header["dropped"], header["lost"]) == (3, 3, 1, 0)


def test_bytes_are_bounded_too_but_the_newest_sample_stays() -> None:
    queue = SampleQueue(1, max_samples=10, max_bytes=5)
    queue.add(samples_of(b"abc", b"def"))
    assert drained(queue)[0] == [b"def"]
    queue.add(samples_of(b"longer than that"))
    assert drained(queue)[0] == [b"longer than that"]


def test_samples_share_a_packet_up_to_its_size_and_a_larger_one_has_its_own() -> None:
    queue = SampleQueue(1, max_samples=10, max_bytes=100 * BATCH_BYTES)
    half = bytes(BATCH_BYTES // 2)
    queue.add(samples_of(half, half, bytes(2 * BATCH_BYTES), half))
    batches = list[Sequence[object]]()
    while queue.waiting:
        (packet,) = PacketReader().feed(queue.take_batch())
        batches.append(packet.header["samples"])
    assert [len(batch) for batch in batches] == [2, 1, 1]


def test_of_a_sample_whose_head_was_asked_for_the_whole_size_is_told() -> None:
    queue = SampleQueue(1, max_samples=10, max_bytes=1000)
    queue.add([Sample(1, 2, 3, b"head", 0, whole=921_600), *samples_of(b"all")])
    (packet,) = PacketReader().feed(queue.take_batch())
    assert packet.header["samples"] == [[1, 2, 3, 4, 921_600], [0, 0, None, 3, 0]]


def test_those_between_every_nth_count_as_received() -> None:
    queue = SampleQueue(1, max_samples=1, max_bytes=1000)
    queue.skipped += 8
    queue.add(samples_of(b"old", b"new"))
    (packet,) = PacketReader().feed(queue.take_batch())
    assert (packet.header["received"], packet.header["dropped"]) == (10, 1)
    assert queue.counts(0) == {"received": 10, "dropped": 1, "lost": 0}


def test_totals_count_up_to_the_samples_of_their_packet() -> None:
    queue = SampleQueue(1, max_samples=10, max_bytes=100 * BATCH_BYTES)
    queue.add(samples_of(bytes(BATCH_BYTES), b"later"))
    (packet,) = PacketReader().feed(queue.take_batch())
    assert packet.header["received"] == 1
    (packet,) = PacketReader().feed(queue.take_batch())
    assert packet.header["received"] == 2


def test_replies_go_before_samples() -> None:
    outbox, queue = Outbox(), SampleQueue(1, 10, 1000)
    outbox.add_samples(queue, samples_of(b"sample"))
    outbox.reply(7, {})
    headers = [packet.header for packet in written_with_samples(outbox, 2)]
    assert [header.get("event", header.get("id")) for header in headers] == [7, "samples"]


def test_the_answer_to_an_end_follows_the_last_samples() -> None:
    outbox, queue = Outbox(), SampleQueue(1, 10, 1000)
    outbox.add_samples(queue, samples_of(b"sample"))
    outbox.reply_after_samples(queue, 8, None)
    packets = written_with_samples(outbox, 2)
    assert packets[0].header["event"] == "samples"
    assert packets[1].header == {"id": 8, "ok": {"received": 1, "dropped": 0, "lost": None}}


def test_that_answer_counts_what_was_sent_before_it_though_it_came_after_the_question() -> None:
    outbox, queue = Outbox(), SampleQueue(1, 10, 1000)
    outbox.add_samples(queue, samples_of(b"before"))
    outbox.reply_after_samples(queue, 8, 0, is_last=False)
    outbox.add_samples(queue, samples_of(b"after"))
    packets = written_with_samples(outbox, 2)
    assert len(packets[0].header["samples"]) == 2
    assert packets[1].header["ok"]["received"] == 2


def test_without_samples_that_answer_goes_at_once() -> None:
    outbox, queue = Outbox(), SampleQueue(1, 10, 1000)
    outbox.reply_after_samples(queue, 8, 0)
    assert [packet.header["id"] for packet in written(outbox)] == [8]


def test_a_flood_on_one_topic_does_not_hold_up_another() -> None:
    outbox, flood, other = Outbox(), SampleQueue(1, 10, 100 * BATCH_BYTES), SampleQueue(2, 10, 1000)
    outbox.add_samples(flood, samples_of(*[bytes(BATCH_BYTES)] * 3))
    outbox.add_samples(other, samples_of(b"small"))
    assert [packet.header["sub"] for packet in written_with_samples(outbox, 4)] == [1, 2, 1, 1]


def test_a_reply_that_no_packet_can_carry_is_an_error() -> None:
    outbox = Outbox()
    outbox.reply(9, {"text": "x" * (16 * 1024 * 1024)})
    (packet,) = written(outbox)
    assert (packet.header["id"], packet.header["error"]["kind"]) == (9, "ros_error")
    assert "larger than the limit" in packet.header["error"]["message"]


def test_what_nobody_expected_answers_as_an_error_of_ros_and_is_logged(capsys: pytest.CaptureFixture[str]) -> None:
    outbox = Outbox()
    outbox.reply_error(1, ValueError("odd"))
    outbox.reply_error(2, OperationError("not_found", "no node", "look"))
    first, second = (packet.header["error"] for packet in written(outbox))
    assert (first["kind"], first["message"]) == ("ros_error", "ValueError: odd")
    assert second == {"kind": "not_found", "message": "no node", "hint": "look"}
    logged = capsys.readouterr().err
    assert "ValueError: odd" in logged
    assert "no node" not in logged


@pytest.mark.parametrize(
    ("stream", "complaint"),
    [
        (pack({"id": 1}, b"body")[:-1], "ended inside a packet"),
        (b"\xff" * 8, "larger than the limit"),
        (b"\0\0\0\2\0\0\0\0[]", "not a JSON object"),
        (b"\0\0\0\2\0\0\0\0{]", "not JSON"),
    ],
)
def test_a_stream_that_is_broken_says_so(stream: bytes, complaint: str) -> None:
    reading, writing = os.pipe()
    os.write(writing, stream)
    os.close(writing)
    with pytest.raises(PacketError, match=complaint):
        list(read_packets(reading))
    os.close(reading)


def written_with_samples(outbox: Outbox, count: int) -> list[Packet]:
    """The next packets that the outbox writes; `finish` would overtake the samples that wait."""
    reading, writing = os.pipe()
    thread = threading.Thread(target=outbox.write_packets, args=(writing,))
    thread.start()
    found, reader = list[Packet](), PacketReader()
    while len(found) < count:
        found.extend(reader.feed(os.read(reading, 65536)))
    outbox.finish()
    thread.join(20)
    os.close(writing)
    os.close(reading)
    return found


def test_all_subscriptions_together_are_bounded_and_the_largest_gives_way(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stream, "MOST_WAITING_BYTES", 1000)
    outbox = Outbox()
    large, small = (SampleQueue(number, max_samples=100, max_bytes=5000) for number in (1, 2))
    outbox.add_samples(small, samples_of(b"s" * 100))
    for _ in range(20):
        outbox.add_samples(large, samples_of(b"l" * 100))
    assert (small.dropped, large.dropped) == (0, 11)
    assert small.bytes + large.bytes == 1000
