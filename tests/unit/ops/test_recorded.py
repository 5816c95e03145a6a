"""A bag as a source, and moments in it."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from ros2_mcp.bags.rosbag2 import qos_text
from ros2_mcp.bags.stored import StoredTopic
from ros2_mcp.bags.writer import BagWriter
from ros2_mcp.model.errors import BadInput, BadValue, NotFound
from ros2_mcp.model.qos import QoS
from ros2_mcp.model.samples import Sample
from ros2_mcp.ops.memory import Memory
from ros2_mcp.ops.moments import moment_ns
from ros2_mcp.ops.recorded import open_source
from ros2_mcp.ops.window import Missing, Source, Window

START_NS = 1_700_000_000_000_000_000
SECOND = 1_000_000_000


def number_at(value: int) -> bytes:
    return b"\0\1\0\0" + value.to_bytes(4, "little")


@pytest.fixture
def memory(tmp_path: Path) -> Memory:
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
    return Memory(tmp_path)


async def windows_of(memory: Memory, start: str, *topics: str) -> list[Window | Missing]:
    source: Source = await open_source(memory, "run", start)
    assert abs(source.duration_s - 2.0) < 1e-6
    assert (await source.scene()).topics.keys() == {"/count", "/mode"}
    found = list(await source.windows(topics, lambda *_: asyncio.sleep(0)))
    async with source.follow("/count") as stream:
        numbers = [number async for batch in stream.batches for number in batch]
    assert len(numbers) == 21
    await memory.close()
    return found


def test_a_window_of_a_bag_has_its_time_and_the_latched_message_before(memory: Memory) -> None:
    count, mode, missing = asyncio.run(windows_of(memory, "last 2 s", "/count", "/mode", "/other"))
    assert isinstance(count, Window) and isinstance(mode, Window) and isinstance(missing, Missing)
    values = [count.decode(sample).data for sample in count.samples]  # type: ignore[attr-defined]
    assert values == list(range(80, 101))
    assert (count.received, count.dropped) == (21, 0)
    assert [mode.decode(sample).data for sample in mode.samples] == [7]  # type: ignore[attr-defined]
    assert isinstance(missing.error, NotFound)


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
