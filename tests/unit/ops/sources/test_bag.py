"""A bag as a source, and moments in it."""

from __future__ import annotations

import sqlite3
from collections.abc import AsyncIterator, Sequence
from contextlib import closing
from pathlib import Path

import pytest

from ros2_mcp.bags.bag import Bag
from ros2_mcp.bags.qos import qos_text
from ros2_mcp.bags.stored import StoredTopic
from ros2_mcp.bags.writer import BagWriter
from ros2_mcp.model.errors import BadInput, BadValue, NotFound, TypeConflict
from ros2_mcp.model.qos import QoS
from ros2_mcp.model.samples import Sample
from ros2_mcp.ops.measure.wait_until import wait_until
from ros2_mcp.ops.memory import bags
from ros2_mcp.ops.memory.bag_store import BLACK_BOX, BagStore
from ros2_mcp.ops.pictures.plot import PlotRequest, plot
from ros2_mcp.ops.sources import bag as bag_source
from ros2_mcp.ops.sources.bag import open_bag
from ros2_mcp.ops.sources.selection import Selection
from ros2_mcp.ops.sources.source import Capture, Missing, Source, Stream
from ros2_mcp.ops.sources.times import parsed_ns, span_of
from ros2_mcp.ops.topics import stats as timing
from ros2_mcp.ops.topics import subscribe as reading
from support.made_bridge import MadeBridge, robot_of

START_NS = 1_700_000_000_000_000_000
SECOND = 1_000_000_000


def number_at(value: int) -> bytes:
    return b"\0\1\0\0" + value.to_bytes(4, "little")


@pytest.fixture
async def store(tmp_path: Path, anyio_backend: str) -> AsyncIterator[BagStore]:
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
    opened = BagStore(tmp_path)
    yield opened
    await opened.close()


class All:
    """Keeps every message."""

    def __init__(self, _: Stream) -> None:
        self.samples: list[Sample] = []

    def add(self, samples: Sequence[Sample]) -> None:
        self.samples += samples


async def captures_of(store: BagStore, start: str, *topics: str) -> list[Capture[All] | Missing]:
    source: Source = await open_bag(store, "run", start)
    assert abs(source.duration_s - 2.0) < 1e-6
    assert (await source.graph()).topics.keys() == {"/count", "/mode"}
    found = list(await source.captures(topics, All))
    async with source.follow("/count") as stream:
        numbers = [number async for batch in stream.batches for number in batch]
    assert len(numbers) == 21
    return found


async def test_a_window_of_a_bag_has_its_time_and_the_latched_message_before(store: BagStore) -> None:
    count, mode, missing = await captures_of(store, "last 2 s", "/count", "/mode", "/other")
    assert isinstance(count, Capture) and isinstance(mode, Capture) and isinstance(missing, Missing)
    values = [count.codec.decode(count.type, sample.data).data for sample in count.kept.samples]  # type: ignore[attr-defined]
    assert values == list(range(80, 101))
    assert (count.received, count.dropped) == (21, 0)
    assert [mode.codec.decode(mode.type, sample.data).data for sample in mode.kept.samples] == [7]  # type: ignore[attr-defined]
    assert isinstance(missing.error, NotFound)


async def read_of(
    store: BagStore, topic: str, selection: Selection, start: str = "", end: str = "", type_name: str = ""
) -> tuple[list[int], str]:
    source = await open_bag(store, "run", start, end)
    found = await reading.read(source, topic, type_name, selection)
    assert found.source == source.lasting(0.0, recorded_s=selection.duration_s).words and (
        found.received,
        found.dropped,
        found.lost,
    ) == (found.count, 0, None)
    return [message["data"] for message in found.messages], found.note


@pytest.mark.promise("ros2_topic_subscribe", "from start on, or without start the last seconds or messages")
@pytest.mark.promise("ros2_topic_echo_wait", "the next message from start on, or without start the last message")
@pytest.mark.promise("ros2_bag_read", "the first ones from start on, or without start the last ones")
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
async def test_a_recording_is_read_from_its_start_or_without_one_from_its_end(
    store: BagStore, start: str, end: str, duration_s: float | None, limit: int | None, expected: list[int]
) -> None:
    selection = Selection(duration_s=duration_s, message_limit=limit)
    values, note = await read_of(store, "count", selection, start, end)
    assert values == expected
    assert ("has no more messages of it" in note) == (limit is not None and limit > len(expected))


async def test_a_latched_message_from_before_the_start_is_read(store: BagStore) -> None:
    assert await read_of(store, "/mode", Selection(), "last 1 s", type_name="std_msgs/Int32") == ([7], "")
    assert await read_of(store, "/mode", Selection(), type_name="std_msgs/Int32") == ([7], "")
    with pytest.raises(TypeConflict, match="not std_msgs/msg/Bool"):
        await read_of(store, "/mode", Selection(), type_name="std_msgs/msg/Bool")


async def test_nothing_in_a_part_is_said_to_be_nothing(store: BagStore) -> None:
    selection = Selection(message_limit=5)
    values, note = await read_of(store, "/count", selection, "first 0.01 s", "first 0.09 s")
    assert values == [] and note == "The recording has no message of it in that part."


async def test_the_flow_of_a_recording_is_that_of_the_whole_or_of_a_part(store: BagStore) -> None:
    async def flow(start: str) -> timing.Stats:
        return await timing.measure(await open_bag(store, "run", start), ["/count", "/mode", "/other"])

    whole, part = await flow(""), await flow("last 2 s")
    assert [topic.count for topic in whole.topics] == [101, 1, 0]
    assert [topic.count for topic in part.topics] == [21, 0, 0]  # a latched message from before is no flow
    count = part.topics[0]
    assert count.rate_hz == pytest.approx(10) and count.gaps == 0 and count.lost is None
    assert count.bytes_per_second == pytest.approx(21 * 8 / 2, rel=0.01)
    assert part.duration == pytest.approx(2) and "bag run, 2 s from" in part.summary()[0]
    assert "no topic /other" in part.topics[2].error


async def follow_while_it_grows(store: BagStore, writer: BagWriter) -> int:
    source = await open_bag(store, "growing", "first 0 s")
    async with source.follow("/count") as stream:
        sizes = [len(await anext(stream.batches))]
        begun = store.opened("growing").bag
        writer.write("/count", Sample(START_NS + SECOND, 0, 999, number_at(999)))
        writer.flush()
        sizes += [len(batch) async for batch in stream.batches]
        assert store.opened("growing").bag is begun
    with store.reading("growing") as bag:
        assert bag is not begun and sum(bag.counts().values()) == sum(sizes) + 1
    return sum(sizes)


async def test_a_recording_that_grows_while_it_is_followed_is_not_opened_again(store: BagStore, tmp_path: Path) -> None:
    (tmp_path / "growing").mkdir()
    writer = BagWriter(tmp_path / "growing", "growing")
    writer.add_topic(StoredTopic("/count", "std_msgs/msg/Int32", None, "ros2msg", "int32 data\n"))
    for number in range(600):
        writer.write("/count", Sample(START_NS + number, 0, number + 1, number_at(number)))
    writer.flush()
    assert await follow_while_it_grows(store, writer) == 600
    writer.close()


async def test_holes_are_those_of_the_files_that_were_read_also_when_the_bag_was_opened_anew_meanwhile(
    store: BagStore, tmp_path: Path
) -> None:
    path = tmp_path / "old.db3"
    with closing(sqlite3.connect(path)) as database:
        database.executescript(
            "CREATE TABLE topics (id INTEGER, name TEXT, type TEXT, serialization_format TEXT);"
            "CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB);"
            "CREATE INDEX timestamp_idx ON messages (timestamp ASC);"
            "INSERT INTO topics VALUES (1, '/count', 'std_msgs/msg/Int32', 'cdr');"
        )
        rows = [(1, START_NS + number, 3.5 if number == 1 else number_at(number)) for number in range(3)]
        database.executemany("INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)", rows)
        database.commit()
        source = await open_bag(store, "old.db3", "first 0 s", robot=robot_of(MadeBridge()))
        async with source.follow("/count") as stream:
            assert len(await anext(stream.batches)) == 2
            database.execute("INSERT INTO messages (topic_id, timestamp, data) VALUES (1, 1, X'00')")
            database.commit()
            with store.reading("old.db3") as opened_anew:
                assert opened_anew.holes == []
            assert stream.holes == [(START_NS + 1, START_NS + 1)]


async def test_answers_about_a_bag_give_times_and_seconds_from_its_beginning(store: BagStore) -> None:
    (line, *_) = (await bags.info(store, "run")).summary()
    span = "from 2023-11-14T22:13:20.000000Z to 2023-11-14T22:13:30.000000Z"
    assert line.startswith(f"run: 102 messages of 2 topics in 10.000 s, {span}. ")
    source = await open_bag(store, "run", "2 s in", "5 s in")
    assert source.words == "bag run, 3.001 s from 2023-11-14T22:13:22.000000Z (2 s in) on"
    early = await open_bag(store, "run", "2020-01-01")
    assert early.words.endswith("(0 s in) on (the recording begins after start)")
    drawn = await plot(source, PlotRequest(["/count:data"]))
    assert (drawn.started_at, drawn.seconds_from_start) == ("2023-11-14T22:13:22.000000Z", 2.0)
    met = await wait_until(source, "/count", "data == 33")
    assert (met.at, met.seconds_from_start) == ("2023-11-14T22:13:23.300000Z", 3.3)
    assert (await read_of(store, "/count", Selection(message_limit=1), f"{met.seconds_from_start} s in"))[0] == [33]
    with pytest.raises(BadValue, match=r"2023-11-14T22:13:30\.000000Z \(10 s in\)\."):
        await open_bag(store, "run", "11 s in")


async def test_of_a_black_box_that_is_being_written_only_times_are_given(store: BagStore, tmp_path: Path) -> None:
    (tmp_path / "run").rename(tmp_path / BLACK_BOX)
    assert "(0 s in)" in (await open_bag(store, BLACK_BOX)).words
    store.writes(tmp_path / BLACK_BOX, lambda: True)
    box = await open_bag(store, BLACK_BOX, "2023-11-14T22:13:22Z", "2023-11-14T22:13:24Z")
    assert box.words == "bag black-box, 2 s from 2023-11-14T22:13:22.000000Z on" and box.began_ns is None


def test_a_bag_outside_of_the_folders_is_never_opened(store: BagStore, tmp_path: Path) -> None:
    for name in ("../run", "/etc", "run/../.."):
        with pytest.raises(BadInput):
            store.find_bag(name)
    with pytest.raises(BadInput, match="NUL"):
        store.find_bag("run\0")
    (tmp_path / "link").symlink_to("/etc")
    with pytest.raises(BadInput):
        store.find_bag("link")


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("last 30 s", 70.0),
        ("30 seconds ago", 70.0),
        ("first 0.5 min", 30.0),
        ("0.5 min in", 30.0),
        ("250 ms", 99.75),
        ("1970-01-01T00:00:07.25Z", 7.25),
        ("1970-01-01T01:00:07.123456789+01:00", 7.123456789),
    ],
)
def test_moments_are_read_as_people_write_them(text: str, seconds: float) -> None:
    assert parsed_ns("start", text, 0, 100 * SECOND) == round(seconds * SECOND)


@pytest.mark.parametrize(
    ("text", "nanoseconds"),
    [
        ("0001-01-01T00:00:00+14:00", -(2**63)),
        ("9999-12-31T23:59:59.999999999-12:00", 2**63 - 1),
        (f"last {'9' * 400} h", -(2**63)),
        ("9999999999999 h in", 2**63 - 1),
    ],
)
def test_far_moments_are_the_farthest_that_64_bits_can_hold(text: str, nanoseconds: int) -> None:
    assert parsed_ns("start", text, 0, 100 * SECOND) == nanoseconds


def test_a_bag_in_sqlite_is_read_from_and_to_far_moments(tmp_path: Path) -> None:
    with closing(sqlite3.connect(tmp_path / "old.db3")) as database:
        database.executescript(
            "CREATE TABLE topics (id INTEGER, name TEXT, type TEXT, serialization_format TEXT);"
            "CREATE TABLE messages (id INTEGER, topic_id INTEGER, timestamp INTEGER, data BLOB);"
            "INSERT INTO topics VALUES (1, '/count', 'std_msgs/msg/Int32', 'cdr');"
            f"INSERT INTO messages VALUES (1, 1, {START_NS}, X'0001000007000000');"
        )
    with Bag(tmp_path / "old.db3") as bag:
        span = span_of("0001-01-01T00:00:00Z", "9999-12-31T00:00:00Z", *(bag.times or (0, 0)))
        assert [sample.received_ns for _, sample in bag.messages(span)] == [START_NS]


@pytest.mark.parametrize(
    ("end", "end_ns"),
    [
        ("1970-01-01T00:00:07Z", 7_000_001_000),
        ("1970-01-01T00:00:07.25Z", 7_250_001_000),
        ("1970-01-01T00:00:07.123456Z", 7_123_457_000),
        ("1970-01-01T00:00:07.12345678Z", 7_123_456_790),
        ("1970-01-01T00:00:07.123456789Z", 7_123_456_790),
        ("first 7 s", 7_000_000_000),
        ("last 93 s", 7_000_000_000),
    ],
)
def test_an_end_that_is_a_time_includes_what_it_names(end: str, end_ns: int) -> None:
    assert span_of("", end, 0, 100 * SECOND).end_ns == end_ns


async def test_what_is_read_between_the_times_that_were_shown_is_everything(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    writer = BagWriter(tmp_path / "run", "run")
    writer.add_topic(StoredTopic("/count", "std_msgs/msg/Int32", None, "ros2msg", "int32 data\n"))
    for number in range(20):
        at_ns = START_NS + number * SECOND + 789
        writer.write("/count", Sample(at_ns, at_ns, number + 1, number_at(number)))
    writer.close()

    store, twenty = BagStore(tmp_path), Selection(message_limit=20)
    shown = await bags.info(store, "run")
    robot = robot_of(MadeBridge())
    assert (await bags.read(robot, store, "run", "/count", twenty, shown.start, shown.end)).count == 20
    source = await open_bag(store, "run", shown.start, shown.end)
    assert (await timing.measure(source, ["/count"])).topics[0].count == 20
    await store.close()


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("yesterday", "not a time"),
        ("last 2 min in", "from both the beginning and the end"),
        ("first 2 min ago", "from both the beginning and the end"),
    ],
)
def test_moments_that_could_mean_something_else_are_refused(text: str, what: str) -> None:
    with pytest.raises(BadValue, match=what):
        parsed_ns("start", text, 0, 100)


@pytest.mark.parametrize("text", ["first 2 min", "2 min in"])
def test_where_the_beginning_is_not_known_nothing_counts_from_it(text: str) -> None:
    with pytest.raises(BadValue, match="the beginning, which is not known"):
        parsed_ns("time_start", text, None, 100)


async def test_messages_that_are_too_much_to_keep_are_told(store: BagStore, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bag_source, "MAX_BYTES", 80)  # ten messages of eight bytes
    found = await reading.read(await open_bag(store, "run"), "/count", "", Selection(message_limit=50))
    assert found.received == 10 and found.note.startswith("There are earlier messages: to read them, give end ")


async def test_topics_of_one_bag_may_have_different_definitions_of_a_type(tmp_path: Path) -> None:
    (tmp_path / "merged").mkdir()
    writer = BagWriter(tmp_path / "merged", "merged")
    for topic, text, body in (("/old", "int32 a\n", number_at(5)), ("/new", "int16 b\nint16 c\n", number_at(5))):
        writer.add_topic(StoredTopic(topic, "made/msg/State", None, "ros2msg", text))
        writer.write(topic, Sample(START_NS, START_NS, 1, body))
    writer.close()
    merged = BagStore(tmp_path)
    try:
        for topic, value in (("/old", {"a": 5}), ("/new", {"b": 5, "c": 0}), ("/old", {"a": 5})):
            found = await reading.read(await open_bag(merged, "merged"), topic, "", Selection())
            assert list(found.messages) == [value]
    finally:
        await merged.close()


class Batches:
    """Keeps how many messages came at once."""

    def __init__(self, _: Stream) -> None:
        self.sizes: list[int] = []

    def add(self, samples: Sequence[Sample]) -> None:
        self.sizes.append(len(samples))


async def test_messages_of_a_rare_topic_are_passed_on_together(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    writer = BagWriter(tmp_path / "run", "run")
    for topic in ("/often", "/rare"):
        writer.add_topic(StoredTopic(topic, "std_msgs/msg/Int32", None, "ros2msg", "int32 data\n"))
    for number in range(3000):
        writer.write("/rare" if number % 100 == 0 else "/often", Sample(START_NS + number, 0, None, number_at(number)))
    writer.close()
    store = BagStore(tmp_path)
    found = await (await open_bag(store, "run")).captures(["/often", "/rare"], Batches)
    often, rare = (capture.kept.sizes for capture in found if isinstance(capture, Capture))
    assert (sum(often), rare) == (2970, [30]) and min(often[:-1]) >= 256
    assert [capture.received for capture in found if isinstance(capture, Capture)] == [2970, 30]
    await store.close()
