"""Packets come out as they went in, whatever the pieces are that the stream arrives in."""

from __future__ import annotations

import pytest

from ros2_mcp_common.wire import packets
from ros2_mcp_common.wire.limits import MAX_HEADER_BYTES
from ros2_mcp_common.wire.packets import PacketError, PacketReader, pack


@pytest.mark.parametrize("size", [1, 7, 100, 10_000])
def test_packets_come_whole_out_of_pieces_of_any_size(size: int) -> None:
    sent = [({"id": 1, "text": "ünï"}, b"body"), ({"id": 2}, b""), ({"id": 3}, bytes(1000))]
    stream = b"".join(pack(header, body) for header, body in sent)
    reader = PacketReader()
    pieces = [stream[at : at + size] for at in range(0, len(stream), size)]
    assert [tuple(packet) for piece in pieces for packet in reader.feed(piece)] == sent
    assert not reader.is_inside_packet


def test_the_beginning_of_a_packet_waits_for_its_rest() -> None:
    reader, packet = PacketReader(), pack({"id": 1})
    assert list(reader.feed(packet[:-1])) == []
    assert reader.is_inside_packet
    assert len(list(reader.feed(packet[-1:]))) == 1


def test_a_packet_larger_than_allowed_is_refused_before_it_is_collected() -> None:
    with pytest.raises(PacketError, match="larger than the limit"):
        list(PacketReader().feed(b"\xff" * 8))


def test_what_the_other_side_would_refuse_is_not_packed(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(PacketError, match="larger than the limit"):
        pack({"text": "x" * MAX_HEADER_BYTES})
    monkeypatch.setattr(packets, "MAX_BODY_BYTES", 10)
    with pytest.raises(PacketError, match=r"11 bytes is larger than the limit of \d+ \+ 10"):
        pack({}, bytes(11))


def test_a_number_that_json_does_not_know_is_not_packed() -> None:
    with pytest.raises(ValueError, match="JSON"):
        pack({"x": float("nan")})
