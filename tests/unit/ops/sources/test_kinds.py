"""Sources of every kind are asked in the same way; a new kind is entered in one place."""

from __future__ import annotations

from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from ros2_mcp.bags.stored import StoredTopic
from ros2_mcp.bags.writer import BagWriter
from ros2_mcp.mcp.binding import bind
from ros2_mcp.model.errors import BadInput, NotFound
from ros2_mcp.model.samples import STAMP_END, Sample
from ros2_mcp.ops.measure import statistics
from ros2_mcp.ops.measure.wait_until import wait_until
from ros2_mcp.ops.memory import bags
from ros2_mcp.ops.memory import messages as history
from ros2_mcp.ops.memory.bag_store import BagStore
from ros2_mcp.ops.pictures import plot as plotting
from ros2_mcp.ops.results.results import AnswerBytes, silent
from ros2_mcp.ops.sources.bag import BagSource, open_bag
from ros2_mcp.ops.sources.kinds import OWN_KINDS, Sources
from ros2_mcp.ops.sources.recorded_robot import recorded_robot
from ros2_mcp.ops.sources.selection import Collector, Selection, fit
from ros2_mcp.ops.sources.source import Source, SourceKind, SourceRequest
from ros2_mcp.ops.topics import subscribe as reading
from ros2_mcp.robot import Robot
from ros2_mcp.tools import DECLARED
from ros2_mcp.values.cdr import Codec
from support.made_bridge import MadeBridge, robot_of
from support.made_windows import CODEC, START_NS, Make, Recorded, encoded

FLOAT = "std_msgs/msg/Float64"
COUNT = StoredTopic("/count", "std_msgs/msg/Int32", None, "ros2msg", "int32 data\n")
SECOND = 1_000_000_000


class MadeSources(SourceKind):
    """All that a new kind of source has to say of how it is found."""

    def __init__(self, source: Source) -> None:
        self._source = source

    async def named(self, robot: Robot, store: BagStore, request: SourceRequest) -> Source | None:  # noqa: ARG002
        return self._source if request.name == "made" else None

    async def kept(self, *_: Any) -> Sequence[Callable[[], Awaitable[Source]]]:
        async def opened() -> Source:
            return self._source

        return [opened]


async def test_a_new_kind_of_source_is_one_class_and_one_line(tmp_path: Path, window: Make) -> None:
    made = Recorded([window("/x", FLOAT, [(each / 10, {"data": float(each)}) for each in range(11)], 1.0)])
    kinds = [MadeSources(made), *OWN_KINDS]
    store = BagStore(tmp_path)
    robot = recorded_robot(store, [AnswerBytes(32_000)])

    async def ask(name: str, **arguments: Any) -> Mapping[str, Any]:
        tool = bind(next(each for each in DECLARED if each.name == name), robot, store, kinds)
        answer = (await tool.call(arguments, silent)).structured_content
        assert answer
        return answer

    (measured,) = (await ask("ros2_topic_statistics", topic_names=["/x"], bag="made"))["topics"]
    assert (measured["count"], measured["fields"][0]["max"]) == (11, 10.0)
    assert (await ask("ros2_topic_stats", topic_names=["/x"], bag="made"))["topics"][0]["rate_hz"] == pytest.approx(10)
    assert (await ask("ros2_wait_until", topic_name="/x", condition="data > 3", bag="made"))["messages_checked"] == 5
    read = await ask("ros2_topic_subscribe", topic_name="/x", bag="made", message_limit=2, every_n=3)
    assert [each["data"] for each in read["messages"]] == [0.0, 3.0]
    assert (await ask("ros2_health_check", bag="made"))["source"] == "made"
    kept = await ask("ros2_get_messages", topic_name="/x")
    assert (kept["source"], kept["count"]) == ("made", 11)


async def test_no_name_means_the_robot_and_moments_mean_a_recording(tmp_path: Path) -> None:
    robot, store = robot_of(MadeBridge()), BagStore(tmp_path)
    assert (await Sources(robot, store).open()).is_live
    with pytest.raises(BadInput, match="no recording is named"):
        await Sources(robot, store).open(start="last 1 s")
    with pytest.raises(NotFound, match="no bag"):
        await Sources(robot, store).open("nowhere")


# ── messages that cannot be decoded ──────────────────────────────────────────────────────────────────────────────────


@pytest.fixture
async def damaged(tmp_path: Path) -> AsyncIterator[BagStore]:
    """A bag of six messages, of which the second and the last one are no Int32."""
    (tmp_path / "run").mkdir()
    writer = BagWriter(tmp_path / "run", "run")
    writer.add_topic(COUNT)
    for number in range(6):
        data = b"\0\1\0\0" if number in (1, 5) else encoded("std_msgs/msg/Int32", {"data": number})
        writer.write("/count", Sample(START_NS + number * SECOND, 0, number, data))
    writer.close()
    store = BagStore(tmp_path)
    yield store
    await store.close()


async def test_what_cannot_be_decoded_is_skipped_counted_and_told_by_whoever_reads(damaged: BagStore) -> None:
    robot = recorded_robot(damaged, [AnswerBytes(32_000)])
    six, told = Selection(message_limit=6), "2 messages that cannot be decoded"
    read = await reading.read(await open_bag(damaged, "run"), "/count", "", six)
    from_bag = await bags.read(robot, damaged, "run", "/count", six)
    await bags.info(damaged, "run")
    kept = await history.get_messages(Sources(robot, damaged), "/count", "", SourceRequest(), Selection())
    for found in (read, from_bag, kept):
        assert [each["data"] for each in found.messages] == [0, 2, 3, 4]
        assert told in found.note
    assert (read.received, read.count, kept.found) == (6, 4, 6)
    waited = await wait_until(await open_bag(damaged, "run"), "/count", "data > 9")
    assert (waited.messages_checked, waited.message) == (4, {"data": 4}) and told in waited.note


async def test_what_cannot_be_decoded_is_not_measured(damaged: BagStore) -> None:
    source = await open_bag(damaged, "run")
    (found,) = (await statistics.measure(source, ["/count"], Selection())).topics
    assert (found.count, found.fields[0].count, found.fields[0].max) == (6, 4, 4.0)
    assert "2 messages that cannot be decoded" in found.note
    drawn = await plotting.plot(source, plotting.PlotRequest(["/count:data"]))
    assert drawn.series[0].count == 4 and "2 messages that cannot be decoded" in drawn.note


# ── decoding and collecting ──────────────────────────────────────────────────────────────────────────────────────────


class Counting(Codec):
    """Counts what it decodes."""

    decoded = 0

    def decode(self, type_name: str, data: bytes) -> object:
        self.decoded += 1
        return super().decode(type_name, data)


def image(seconds: float) -> Sample:
    value = {"height": 480, "width": 640, "encoding": "rgb8", "step": 1920, "data": [0] * (480 * 1920)}
    return Sample(START_NS + round(seconds * SECOND), 0, None, encoded("sensor_msgs/msg/Image", value))


def test_a_picture_is_decoded_once() -> None:
    codec = Counting(CODEC.definitions)
    fitted = fit(codec, "sensor_msgs/msg/Image", [image(0.0), image(1.0)], Selection())
    images, problem = reading.pictures_of("sensor_msgs/msg/Image", fitted)
    assert (len(images), problem, codec.decoded) == (2, "", 2)


async def test_the_types_of_a_bag_are_compiled_once_for_all_who_read_it(damaged: BagStore) -> None:
    first, second = await open_bag(damaged, "run"), await open_bag(damaged, "run", "last 2 s")
    assert isinstance(first, BagSource) and first.codec is second.codec
    await first.type_of("/count")
    assert second.codec.definitions.knows("std_msgs/msg/Int32")


async def test_a_bag_whose_types_have_changed_is_read_with_the_new_ones(damaged: BagStore, tmp_path: Path) -> None:
    before = (await open_bag(damaged, "run")).codec
    (tmp_path / "run" / "run_0.mcap").unlink()
    writer = BagWriter(tmp_path / "run", "other")
    writer.add_topic(StoredTopic("/count", "std_msgs/msg/Int32", None, "ros2msg", "int32 value\n"))
    writer.write("/count", Sample(START_NS, 0, 1, encoded("std_msgs/msg/Int32", {"data": 7})))
    writer.close()
    source = await open_bag(damaged, "run")
    assert source.codec is not before
    assert (await reading.read(source, "/count", "", Selection())).messages == [{"value": 7}]


def test_a_collector_keeps_the_newest_within_its_bounds_and_counts_the_others() -> None:
    samples = [Sample(each, 0, None, bytes(10)) for each in range(10)]
    collector = Collector(max_bytes=35)
    assert not collector.add(samples)
    assert ([each.received_ns for each in collector.samples], collector.seen, collector.dropped) == ([7, 8, 9], 10, 7)
    thinned = Collector(every_n=3, enough=3)
    assert thinned.add(samples)
    assert ([each.received_ns for each in thinned.samples], thinned.seen) == ([0, 3, 6], 7)


def test_a_collector_of_times_keeps_no_more_bytes_than_those_of_a_stamp() -> None:
    collector = Collector(max_bytes=1, times_only=True)
    collector.add([Sample(each, 0, None, bytes(100)) for each in range(10)])
    assert [each.data for each in collector.samples] == [bytes(STAMP_END)] * 10


async def test_of_a_bag_every_nth_message_is_counted_from_the_end_where_the_last_ones_are_meant(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    writer = BagWriter(tmp_path / "run", "run")
    writer.add_topic(COUNT)
    for number in range(10):
        data = encoded("std_msgs/msg/Int32", {"data": number})
        writer.write("/count", Sample(START_NS + number * SECOND, 0, number, data))
    writer.close()
    store, thinned = BagStore(tmp_path), Selection(message_limit=2, every_n=3)
    robot = recorded_robot(store, [AnswerBytes(32_000)])
    for start, expected in (("", [6, 9]), ("first 1 s", [1, 4])):
        read = await reading.read(await open_bag(store, "run", start), "/count", "", thinned)
        from_bag = await bags.read(robot, store, "run", "/count", thinned, start)
        assert [each["data"] for each in read.messages] == [each["data"] for each in from_bag.messages] == expected
    await store.close()
