"""What is collected of topics is bounded for each reader, and for all of them together."""

from __future__ import annotations

import pytest

from ros2_mcp.model.samples import Sample
from ros2_mcp.ops.sources import selection
from ros2_mcp.ops.sources.selection import Collector

BYTES = 2_000_000
"""Of one sample."""


def samples(count: int) -> list[Sample]:
    return [Sample(number, 0, None, b"x" * BYTES) for number in range(count)]


def test_one_reader_alone_keeps_what_it_may() -> None:
    collector = Collector(max_bytes=10 * BYTES)
    collector.add(samples(20))
    assert (len(collector.samples), collector.dropped, collector.seen) == (10, 10, 20)


def test_many_readers_share_what_all_may_have_and_those_of_little_are_left_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(selection, "MAX_BYTES_IN_TOTAL", 24 * BYTES)
    small = Collector()
    small.add([Sample(number, 0, None, b"x" * 1000) for number in range(500)])
    readers = [Collector(max_bytes=20 * BYTES) for _ in range(8)]
    for _ in range(20):
        for reader in readers:
            reader.add(samples(1))
    assert sum(len(reader.samples) for reader in readers) <= 24
    assert all(reader.samples[-1].received_ns == 0 and reader.seen == 20 for reader in readers)
    assert all(len(reader.samples) + reader.dropped == 20 for reader in readers)
    assert (len(small.samples), small.dropped) == (500, 0)


def test_who_has_ended_takes_no_part(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(selection, "MAX_BYTES_IN_TOTAL", 24 * BYTES)
    readers = [Collector() for _ in range(8)]
    for reader in readers:
        reader.add(samples(3))
    del readers, reader
    alone = Collector(max_bytes=20 * BYTES)
    alone.add(samples(30))
    assert len(alone.samples) == 20
