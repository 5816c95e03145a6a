"""A bag as a source, and moments in it."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from pathlib import Path

import pytest

from ros2_mcp.bags.rosbag2 import qos_text
from ros2_mcp.bags.stored import StoredTopic
from ros2_mcp.bags.writer import BagWriter
from ros2_mcp.model.errors import BadInput, BadValue, NotFound, TypeConflict
from ros2_mcp.model.qos import QoS
from ros2_mcp.model.samples import Sample
from ros2_mcp.ops import reading, timing
from ros2_mcp.ops.memory import Memory
from ros2_mcp.ops.moments import moment_ns
from ros2_mcp.ops.recorded import open_source
from ros2_mcp.ops.window import Missing, Source, Window

START_NS = 1_700_000_000_000_000_000
SECOND = 1_000_000_000


def number_at(value: int) -> bytes:
    return b"\0\1\0\0" + value.to_bytes(4, "little")


@pytest.fixture
def memory(tmp_path: Path) -> Iterator[Memory]:
    (tmp_path / "run").mkdir()
    writer = BagWriter(tmp_path / "run", "run")
    writer.add_topic(StoredTopic("/count", "std_msgs/msg/Int32", None, "ros2msg", "int32 data\n"))
    writer.add_topic(
        StoredTopic("/mode", "std_msgs/msg/Int32", None, "", "", qos_text([QoS(durability="transient_local")]))
    )
    writer.write("/mode", Sample(START_NS, START_NS, 1, number_at(7)))
    for number in range(101):
        at_ns = START_NS + number * SECOND // 10
        writer.write("/count", Sample(at_ns, at_ns, number + 1, number_at(number)))
    writer.close()
    opened = Memory(tmp_path)
    yield opened
    asyncio.run(opened.close())


async def windows_of(memory: Memory, start: str, *topics: str) -> list[Window | Missing]:
    source: Source = await open_source(memory, "run", start)
    assert abs(source.duration_s - 2.0) < 1e-6
    assert (await source.scene()).topics.keys() == {"/count", "/mode"}
    found = list(await source.windows(topics, lambda *_: asyncio.sleep(0)))
    async with source.follow("/count") as stream:
        numbers = [number async for batch in stream.batches for number in batch]
    assert len(numbers) == 21
    return found


def test_a_window_of_a_bag_has_its_time_and_the_latched_message_before(memory: Memory) -> None:
    count, mode, missing = asyncio.run(windows_of(memory, "last 2 s", "/count", "/mode", "/other"))
    assert isinstance(count, Window) and isinstance(mode, Window) and isinstance(missing, Missing)
    values = [count.decode(sample).data for sample in count.samples]  # type: ignore[attr-defined]
    assert values == list(range(80, 101))
    assert (count.received, count.dropped) == (21, 0)
    assert [mode.decode(sample).data for sample in mode.samples] == [7]  # type: ignore[attr-defined]
    assert isinstance(missing.error, NotFound)


async def read_of(memory: Memory, request: reading.Request, start: str = "", end: str = "") -> tuple[list[int], str]:
    source = await open_source(memory, "run", start, end, longest_s=request.duration_s)
    found = await reading.read(source, request, reading.View())
    assert found.source == source.words and (found.received, found.dropped, found.lost) == (found.count, 0, None)
    return [message["data"] for message in found.messages], found.note


@pytest.mark.parametrize(
    ("start", "end", "duration_s", "limit", "expected"),
    [
        ("", "", None, None, [100]),
        ("", "", None, 3, [98, 99, 100]),
        ("", "", 0.25, None, [98, 99, 100]),
        ("", "last 5 s", None, 2, [48, 49]),
        ("first 2 s", "", None, None, [20]),
        ("first 2 s", "", None, 3, [20, 21, 22]),
        ("first 2 s", "", 0.25, None, [20, 21, 22]),
        ("first 2 s", "first 2.2 s", 9.0, None, [20, 21]),
        ("last 0.1 s", "", None, 5, [99, 100]),
    ],
)
def test_a_recording_is_read_from_its_start_or_without_one_from_its_end(
    memory: Memory, start: str, end: str, duration_s: float | None, limit: int | None, expected: list[int]
) -> None:
    request = reading.Request("count", "", duration_s, limit)
    values, note = asyncio.run(read_of(memory, request, start, end))
    assert values == expected
    assert ("has no more of it" in note) == (limit is not None and limit > len(expected))


def test_a_latched_message_from_before_the_start_is_read(memory: Memory) -> None:
    request = reading.Request("/mode", "std_msgs/Int32")
    assert asyncio.run(read_of(memory, request, "last 1 s")) == ([7], "")
    assert asyncio.run(read_of(memory, request)) == ([7], "")
    with pytest.raises(TypeConflict, match="not std_msgs/msg/Bool"):
        asyncio.run(read_of(memory, reading.Request("/mode", "std_msgs/msg/Bool")))


def test_nothing_in_a_part_is_said_to_be_nothing(memory: Memory) -> None:
    request = reading.Request("/count", "", None, 5)
    values, note = asyncio.run(read_of(memory, request, "first 0.01 s", "first 0.09 s"))
    assert values == [] and note == "The recording has nothing of it in that part."


def test_the_flow_of_a_recording_is_that_of_the_whole_or_of_a_part(memory: Memory) -> None:
    async def flow(start: str) -> timing.Stats:
        return await timing.measure(await open_source(memory, "run", start), ["/count", "/mode", "/other"])

    whole, part = asyncio.run(flow("")), asyncio.run(flow("last 2 s"))
    assert [topic.count for topic in whole.topics] == [101, 1, 0]
    assert [topic.count for topic in part.topics] == [21, 0, 0]  # a latched message from before is no flow
    count = part.topics[0]
    assert count.rate_hz == pytest.approx(10) and count.gaps == 0 and count.lost is None
    assert count.bytes_per_second == pytest.approx(21 * 8 / 2, rel=0.01)
    assert part.duration == pytest.approx(2) and "bag run, 2 s from" in part.summary()
    assert "no topic /other" in part.topics[2].error


async def follow_while_it_grows(memory: Memory, writer: BagWriter) -> int:
    source = await open_source(memory, "growing", "first 0 s")
    async with source.follow("/count") as stream:
        sizes = [len(await anext(stream.batches))]
        begun = memory.opened("growing").bag
        writer.write("/count", Sample(START_NS + SECOND, 0, 999, number_at(999)))
        writer.flush()
        sizes += [len(batch) async for batch in stream.batches]
        assert memory.opened("growing").bag is begun
    with memory.reading("growing") as bag:
        assert bag is not begun and bag.count == sum(sizes) + 1
    return sum(sizes)


def test_a_recording_that_grows_while_it_is_followed_is_not_opened_again(memory: Memory, tmp_path: Path) -> None:
    (tmp_path / "growing").mkdir()
    writer = BagWriter(tmp_path / "growing", "growing")
    writer.add_topic(StoredTopic("/count", "std_msgs/msg/Int32", None, "ros2msg", "int32 data\n"))
    for number in range(600):
        writer.write("/count", Sample(START_NS + number, 0, number + 1, number_at(number)))
    writer.flush()
    assert asyncio.run(follow_while_it_grows(memory, writer)) == 600
    writer.close()


def test_a_bag_outside_of_the_folders_is_never_opened(memory: Memory, tmp_path: Path) -> None:
    for name in ("../run", "/etc", "run/../.."):
        with pytest.raises(BadInput):
            memory.find_bag(name)
    (tmp_path / "link").symlink_to("/etc")
    with pytest.raises(BadInput):
        memory.find_bag("link")


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("last 30 s", 70.0),
        ("30 seconds ago", 70.0),
        ("first 0.5 min", 30.0),
        ("250 ms", 99.75),
        ("1970-01-01T00:00:07.25Z", 7.25),
        ("1970-01-01T01:00:07.123456789+01:00", 7.123456789),
    ],
)
def test_moments_are_read_as_people_write_them(text: str, seconds: float) -> None:
    assert moment_ns("start", text, 0, 100 * SECOND) == round(seconds * SECOND)


@pytest.mark.parametrize(("text", "what"), [("2026-11-21T03:00:00", "time zone"), ("yesterday", "not a moment")])
def test_moments_that_could_mean_something_else_are_refused(text: str, what: str) -> None:
    with pytest.raises(BadValue, match=what):
        moment_ns("start", text, 0, 100)
