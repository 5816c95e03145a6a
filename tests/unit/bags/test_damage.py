"""Damaged bags give what can be read and say what is missing: never a wrong message, never a crash."""

from __future__ import annotations

import random
import sqlite3
import struct
import tracemalloc
import zlib
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from mcap.writer import CompressionType, Writer

from ros2_mcp.bags import chunks, sqlite_file
from ros2_mcp.bags.bag import Bag
from ros2_mcp.bags.stored import Hole, Span, StoredTopic
from ros2_mcp.bags.writer import BagWriter
from ros2_mcp.model.errors import BadData, Locked
from ros2_mcp.model.samples import Sample
from ros2_mcp.model.times import iso_time
from support.rounds import FULL

OpenBag = Callable[[Path], Bag]
FLIPS = 10_000 if FULL else 300
MASKS = range(1, 256) if FULL else [1 << bit for bit in range(8)]
TOPICS = ("/first", "/second")
Message = tuple[str, Sample]


def written(folder: Path, *, closed: bool, count: int = 200) -> tuple[Path, list[Message]]:
    """A small recording with many chunks; without an end if it is not `closed`."""
    folder.mkdir()
    writer = BagWriter(folder, folder.name)
    for topic in TOPICS:
        writer.add_topic(StoredTopic(topic, "demo/msg/Raw", None, "ros2msg", "uint8[] data\n"))
    chance = random.Random(7)
    messages: list[Message] = []
    for number in range(count):
        at_ns = 1_700_000_000_000_000_000 + number * 1_000_000
        body = b"\0\1\0\0" + chance.randbytes(chance.randrange(4, 80))
        messages.append((TOPICS[number % 2], Sample(at_ns, at_ns - 3, number + 1, body)))
        writer.write(*messages[-1])
        if number % 20 == 19:
            writer.flush()
    if closed:
        writer.close()
    else:
        writer.abandon()
    return writer.path, messages


def check(path: Path, messages: list[Message]) -> bool:
    """Whether damage was noticed; fails if something was read that was not written, or missing without a word."""
    try:
        with Bag(path) as bag:
            read = list(bag.messages())
            problems = bag.problems
    except BadData:
        return True
    remaining = iter(messages)
    assert all(message in remaining for message in read), "a message that was never written, or the wrong order"
    assert len(read) == len(messages) or problems, f"{len(messages) - len(read)} messages are missing without a word"
    return bool(problems)


@pytest.mark.parametrize("closed", [True, False], ids=["closed", "killed"])
def test_a_flipped_byte_is_noticed_or_harmless(tmp_path: Path, closed: bool) -> None:
    path, messages = written(tmp_path / "run", closed=closed)
    whole = path.read_bytes()
    chance = random.Random(2026)
    target = tmp_path / "flipped.mcap"
    for _ in range(FLIPS // 2):
        place = chance.randrange(len(whole))
        flipped = bytes([whole[place] ^ (1 << chance.randrange(8))])
        target.write_bytes(whole[:place] + flipped + whole[place + 1 :])
        check(target, messages)


def test_every_byte_of_the_heads_may_be_flipped(tmp_path: Path) -> None:
    """The first chunk's head, its index records and the head of the next chunk, each bit."""
    path, messages = written(tmp_path / "run", closed=False, count=40)
    whole = path.read_bytes()
    second = whole.index(b"\x06", whole.index(b"\x07\x26"))
    target = tmp_path / "flipped.mcap"
    for place in [*range(100), *range(second - 120, second + 70)]:
        for bit in range(8):
            target.write_bytes(whole[:place] + bytes([whole[place] ^ (1 << bit)]) + whole[place + 1 :])
            check(target, messages)


def test_a_cut_file_gives_everything_before_the_cut(tmp_path: Path) -> None:
    path, messages = written(tmp_path / "run", closed=True)
    whole = path.read_bytes()
    target = tmp_path / "cut.mcap"
    for share in (0.1, 0.3, 0.5, 0.7, 0.9):
        target.write_bytes(whole[: int(len(whole) * share)])
        assert check(target, messages)
    with Bag(target) as bag:
        assert len(list(bag.messages())) >= 140


def test_a_hole_costs_only_the_chunks_it_touches(tmp_path: Path, open_bag: OpenBag) -> None:
    path, messages = written(tmp_path / "run", closed=False)
    whole = path.read_bytes()
    middle = len(whole) // 2
    path.write_bytes(whole[:middle] + bytes(300) + whole[middle + 300 :])
    bag = open_bag(tmp_path / "run")
    assert len(list(bag.messages())) >= len(messages) - 60
    assert any("bytes are lost" in problem for problem in bag.problems)


@pytest.fixture
def little_memory() -> Iterator[None]:
    """The test fails if it takes much more than the few kilobytes that its bags have."""
    tracemalloc.start()
    yield
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 32_000_000


def compressed(path: Path, kind: CompressionType) -> list[Message]:
    """A recording as rosbag2 compresses it: chunk by chunk."""
    messages = [("/first", Sample(1000 + n, 1000 + n, n + 1, b"\0\1\0\0" + bytes([n]) * 600)) for n in range(200)]
    with path.open("wb") as file:
        writer = Writer(file, 20_000, kind)
        writer.start("ros2", "test")
        schema = writer.register_schema("demo/msg/Raw", "ros2msg", b"uint8[] data\n")
        channel = writer.register_channel("/first", "cdr", schema)
        for _, sample in messages:
            writer.add_message(channel, sample.received_ns, sample.data, sample.source_ns, sample.sequence or 0)
        writer.finish()
    return messages


@pytest.mark.usefixtures("little_memory")
@pytest.mark.parametrize("ended", [True, False], ids=["with index", "without index"])
@pytest.mark.parametrize("kind", [CompressionType.ZSTD, CompressionType.LZ4])
def test_a_flipped_byte_in_a_compressed_frame_costs_its_chunk_only(
    tmp_path: Path, kind: CompressionType, ended: bool
) -> None:
    path = tmp_path / "run.mcap"
    messages = compressed(path, kind)
    magic = b"\x28\xb5\x2f\xfd" if kind == CompressionType.ZSTD else b"\x04\x22\x4d\x18"
    whole = path.read_bytes() if ended else path.read_bytes()[:-20]
    frame = whole.index(magic, whole.index(magic) + 1)
    for place in range(frame, frame + 16):
        for mask in MASKS:
            path.write_bytes(whole[:place] + bytes([whole[place] ^ mask]) + whole[place + 1 :])
            with Bag(path) as bag:
                read = list(bag.messages())
                assert read == messages or (messages[0] in read and messages[-1] in read and bag.problems)
                assert len(read) > len(messages) - 50


def lz4_packed(data: bytes) -> bytes:
    return bytes(lz4.frame.compress(data))  # pyright: ignore[reportUnknownMemberType, reportUnknownArgumentType]


@pytest.mark.usefixtures("little_memory")
@pytest.mark.parametrize("kind", ["zstd", "lz4"])
def test_no_byte_in_the_head_of_compressed_data_makes_a_chunk_large_or_wrong(kind: str) -> None:
    inside = bytes(700)
    packed = zstandard.ZstdCompressor().compress(inside) if kind == "zstd" else lz4_packed(inside)
    for place in range(16):
        for mask in range(1, 256):
            flipped = packed[:place] + bytes([packed[place] ^ mask]) + packed[place + 1 :]
            try:
                assert chunks.unpacked(chunk(kind.encode(), flipped, 700)) == inside
            except chunks.Damaged:
                continue


def chunk(kind: bytes, data: bytes, size: int) -> bytes:
    """The content of a chunk record that says its data is of `size` bytes."""
    head = struct.pack("<QQQII", 0, 0, size, zlib.crc32(bytes(size % 1000)), len(kind))
    return head + kind + len(data).to_bytes(8, "little") + data


ZEROS = 200_000_000


def packed_zeros(kind: str) -> bytes:
    """A few kilobytes that become 200 MB; lz4 needs 800 kB for that."""
    if kind == "lz4":
        return lz4_packed(bytes(ZEROS))
    whole = zstandard.ZstdCompressor()
    if kind == "zstd":
        return whole.compress(bytes(ZEROS))
    stream = whole.compressobj()  # it does not say its size
    return stream.compress(bytes(ZEROS)) + stream.flush()


@pytest.mark.parametrize("kind", ["zstd", "zstd of unknown size", "lz4"])
@pytest.mark.parametrize("size", [0, 1000, chunks.MAX_CHUNK + 1, 1 << 60])
def test_a_chunk_that_becomes_more_than_it_says_is_damaged(kind: str, size: int) -> None:
    data = packed_zeros(kind)
    tracemalloc.start()
    with pytest.raises(chunks.Damaged):
        chunks.unpacked(chunk(kind[:4].strip().encode(), data, size))
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 8_000_000


@pytest.mark.parametrize("content", [b"", b"\x89MCAP0\r\n", b"hello" * 100, bytes(5000)])
def test_what_is_no_bag_is_an_error_in_words(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "no.mcap"
    path.write_bytes(content)
    try:
        with Bag(path) as bag:
            assert list(bag.messages()) == []
            assert bag.problems
    except BadData as error:
        assert "no.mcap" in str(error)


def database(path: Path, count: int, *, packed: bool = False) -> list[Message]:
    """A rosbag2 database as Foxy and Humble write it: without definitions."""
    connection = sqlite3.connect(path)
    connection.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT)")
    connection.execute(
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB NOT NULL)"
    )
    connection.execute("CREATE INDEX timestamp_idx ON messages (timestamp ASC)")
    connection.executemany("INSERT INTO topics VALUES(?, ?, 'demo/msg/Raw', 'cdr')", enumerate(TOPICS))
    messages = [(TOPICS[n % 2], Sample(1000 + n, 0, None, b"\0\1\0\0" + bytes([n % 256]) * 600)) for n in range(count)]
    pack = zstandard.ZstdCompressor().compress if packed else bytes
    rows = [(n % 2, sample.received_ns, pack(sample.data)) for n, (_, sample) in enumerate(messages)]
    connection.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES(?, ?, ?)", rows)
    connection.commit()
    connection.close()
    return messages


def steps_to_read(path: Path, count: int, monkeypatch: pytest.MonkeyPatch, *, newest_first: bool) -> int:
    """How many thousand instructions SQLite needs for that many messages of one moment."""
    messages = database(path, count)
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("UPDATE messages SET timestamp = 1000")
        connection.commit()
    steps, connect = 0, sqlite_file._connect

    def tell() -> None:
        nonlocal steps
        steps += 1

    def counting(of: Path) -> sqlite3.Connection:
        connection = connect(of)
        connection.set_progress_handler(tell, 1000)
        return connection

    monkeypatch.setattr(sqlite_file, "_connect", counting)
    file = sqlite_file.SqliteFile(path)
    read = [sample.data for _, sample in file.messages(Span(None), newest_first)]
    file.close()
    monkeypatch.setattr(sqlite_file, "_connect", connect)
    sent = [sample.data for _, sample in messages]
    assert read == (sent[::-1] if newest_first else sent)
    return steps


@pytest.mark.parametrize("newest_first", [False, True])
def test_many_messages_of_one_moment_are_read_in_a_time_that_grows_as_they_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, newest_first: bool
) -> None:
    few, many = (
        steps_to_read(tmp_path / f"{count}.db3", count, monkeypatch, newest_first=newest_first)
        for count in (4_000, 16_000)
    )
    assert many < 6 * few


METADATA = """rosbag2_bagfile_information:
  version: 5
  storage_identifier: sqlite3
  relative_file_paths: [run_0.db3, run_1.db3]
  message_count: 100
  compression_mode: MESSAGE
  compression_format: zstd
"""


def test_a_sqlite_bag_is_read_with_compressed_messages_and_says_which_file_is_missing(
    tmp_path: Path, open_bag: OpenBag
) -> None:
    messages = database(tmp_path / "run_0.db3", 60, packed=True)
    (tmp_path / "metadata.yaml").write_text(METADATA)
    bag = open_bag(tmp_path)
    assert list(bag.messages()) == messages
    assert bag.last("/second", 2) == [messages[57][1], messages[59][1]]
    assert bag.problems == [
        "run_1.db3 is listed in metadata.yaml, but missing: its messages after 1970-01-01T00:00:00.000001Z are lost, "
        "if there were more.",
        "metadata.yaml lists 100 messages, but the bag has 60.",
    ]


def test_a_sqlite_bag_that_was_cut_gives_what_can_be_read(tmp_path: Path, open_bag: OpenBag) -> None:
    messages = database(tmp_path / "run_0.db3", 3000)
    whole = (tmp_path / "run_0.db3").read_bytes()
    (tmp_path / "run_0.db3").write_bytes(whole[: len(whole) * 2 // 3])
    try:
        bag = open_bag(tmp_path)
    except BadData:
        return
    read = list(bag.messages())
    assert read == messages[: len(read)]
    assert any("lost" in problem for problem in bag.problems)


def test_a_file_that_is_compressed_as_a_whole_is_read(tmp_path: Path, open_bag: OpenBag) -> None:
    messages = database(tmp_path / "plain.db3", 60)
    packed = zstandard.ZstdCompressor().compress((tmp_path / "plain.db3").read_bytes())
    (tmp_path / "run_0.db3.zstd").write_bytes(packed)
    assert list(open_bag(tmp_path / "run_0.db3.zstd").messages()) == messages


@pytest.mark.usefixtures("little_memory")
def test_a_flipped_byte_in_a_compressed_message_costs_that_message_only(tmp_path: Path) -> None:
    messages = database(tmp_path / "run_0.db3", 3, packed=True)
    (tmp_path / "metadata.yaml").write_text(METADATA)
    whole = (tmp_path / "run_0.db3").read_bytes()
    frame = whole.index(zstandard.ZstdCompressor().compress(messages[1][1].data))
    for place in range(frame, frame + 16):
        for mask in MASKS:
            flipped = whole[:place] + bytes([whole[place] ^ mask]) + whole[place + 1 :]
            (tmp_path / "run_0.db3").write_bytes(flipped)
            with Bag(tmp_path) as bag:
                read = list(bag.messages())
            assert [each for each in read if each[1].received_ns != messages[1][1].received_ns] == messages[::2]
            assert len(read) == 3 or any("cannot be read" in problem for problem in bag.problems)


def test_a_damaged_chunk_is_told_with_its_times(tmp_path: Path, open_bag: OpenBag) -> None:
    path, messages = written(tmp_path / "run", closed=True)
    damage_in_the_middle(path)
    bag = open_bag(tmp_path / "run")
    read = list(bag.messages())
    lost = sorted(sample.received_ns for _, sample in messages if (_, sample) not in read)
    (hole,) = bag.holes
    assert len(lost) == 20
    assert (hole.start_ns, hole.end_ns, hole.topics) == (lost[0], lost[-1], frozenset(TOPICS))
    (problem,) = bag.problems
    assert f"from {iso_time(lost[0])} to {iso_time(lost[-1])} are lost" in problem


def test_damage_in_a_file_without_an_index_is_told_with_the_times_around_it(tmp_path: Path, open_bag: OpenBag) -> None:
    path, messages = written(tmp_path / "run", closed=False)
    damage_in_the_middle(path)
    bag = open_bag(tmp_path / "run")
    read = {sample.received_ns for _, sample in bag.messages()}
    lost = sorted(sample.received_ns for _, sample in messages if sample.received_ns not in read)
    (hole,) = bag.holes
    assert (hole.start_ns, hole.end_ns) == (lost[0] - 1_000_000, lost[-1] + 1_000_000)
    assert any(iso_time(hole.start_ns) in text and iso_time(hole.end_ns) in text for text in bag.problems)


def test_a_file_that_was_cut_is_told_with_the_time_of_its_last_message(tmp_path: Path, open_bag: OpenBag) -> None:
    path, _ = written(tmp_path / "run", closed=True)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    bag = open_bag(tmp_path / "run")
    assert any(f"after {iso_time(bag.times[1])} are lost" in text for text in bag.problems)  # type: ignore[index]


@pytest.mark.parametrize("newest_first", [False, True])
def test_a_damaged_page_of_a_database_costs_the_messages_in_it_only(
    tmp_path: Path, open_bag: OpenBag, newest_first: bool
) -> None:
    messages = database(tmp_path / "run_0.db3", 3000)
    whole = bytearray((tmp_path / "run_0.db3").read_bytes())
    page = len(whole) // 2 // 4096 * 4096
    whole[page : page + 4096] = bytes(4096)
    (tmp_path / "run_0.db3").write_bytes(whole)
    bag = open_bag(tmp_path / "run_0.db3")
    read = sorted(bag.messages(newest_first=newest_first), key=lambda message: message[1].received_ns)
    assert len(messages) - 10 < len(read) < len(messages)
    lost = [sample.received_ns for _, sample in messages if sample not in {each for _, each in read}]
    (hole,) = bag.holes
    assert hole.start_ns <= lost[0] <= lost[-1] <= hole.end_ns
    assert any("are lost" in text for text in bag.problems)


def damage_in_the_middle(path: Path) -> None:
    """Flips a byte in the middle of the chunk in the middle of the messages."""
    whole = bytearray(path.read_bytes())
    summary = whole.rfind(b"\x0f\x04\0\0\0\0\0\0\0")  # the record that ends the messages
    middle = (summary if summary > 0 else len(whole)) // 2
    whole[middle] ^= 0xFF
    path.write_bytes(whole)


def with_a_damaged_page(path: Path) -> list[Message]:
    """A database with one message of `/first`, the last one before the damage, and all others of `/second`."""
    messages = database(path, 3000)
    whole = bytearray(path.read_bytes())
    page = len(whole) // 2 // 4096 * 4096
    whole[page : page + 4096] = bytes(4096)
    path.write_bytes(whole)
    with Bag(path) as bag:
        list(bag.messages())
        (hole,) = bag.holes
    with sqlite3.connect(path) as connection:  # neither index nor size changes: each page stays where it is
        connection.execute("UPDATE messages SET topic_id = 1 WHERE timestamp < ?", (hole.start_ns,))
        connection.execute("UPDATE messages SET topic_id = 0 WHERE timestamp = ?", (hole.start_ns,))
        connection.execute("UPDATE messages SET topic_id = 1 WHERE timestamp > 2990")
    connection.close()
    return [message for message in messages if message[1].received_ns == hole.start_ns]


@pytest.mark.parametrize("newest_first", [False, True])
def test_the_message_before_damage_is_read_and_no_topic_widens_the_hole(
    tmp_path: Path, open_bag: OpenBag, newest_first: bool
) -> None:
    path = tmp_path / "run_0.db3"
    ((_, latched),) = with_a_damaged_page(path)
    rare_first, frequent_first = open_bag(path), open_bag(path)
    for bag, topics in ((rare_first, TOPICS), (frequent_first, TOPICS[::-1])):
        for topic in topics:
            read = [sample for _, sample in bag.messages(Span((topic,)), newest_first)]
            assert topic == "/second" or latched in read
    (hole,) = rare_first.holes
    assert rare_first.holes == frequent_first.holes
    assert hole.end_ns - hole.start_ns < 20


@pytest.mark.parametrize("wrong", [500_000_000, 3.5, "text"])
def test_a_message_that_is_not_of_bytes_is_a_hole_at_its_time(tmp_path: Path, open_bag: OpenBag, wrong: object) -> None:
    path = tmp_path / "run_0.db3"
    messages = database(path, 5)
    with sqlite3.connect(path) as connection:
        connection.execute("UPDATE messages SET data = ? WHERE timestamp = 1002", (wrong,))
    connection.close()
    bag = open_bag(path)
    for _ in range(3):  # and however often it is read, it is told once
        assert list(bag.messages()) == messages[:2] + messages[3:]
    assert bag.holes == [Hole(1002, 1002, frozenset(("/first",)))]


def test_a_database_that_was_checked_in_part_can_be_written_and_the_check_goes_on(
    tmp_path: Path, open_bag: OpenBag
) -> None:
    path = tmp_path / "run_0.db3"
    database(path, 5)
    bag = open_bag(path)
    turns = 0
    while not bag.check(0) and turns < 10:
        turns += 1
        with sqlite3.connect(path, timeout=0) as connection:
            connection.execute("UPDATE messages SET topic_id = topic_id")
        connection.close()
    assert bag.check(10)


def test_a_database_that_somebody_writes_to_is_locked_and_not_damaged(
    tmp_path: Path, open_bag: OpenBag, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sqlite_file, "_BUSY_S", 0.01)
    path = tmp_path / "run_0.db3"
    messages = database(path, 3000)
    bag = open_bag(path)
    reading = bag.messages()
    read = [next(reading)]
    with closing(sqlite3.connect(path, isolation_level=None)) as writer:
        writer.execute("BEGIN EXCLUSIVE")
        for ask in (lambda: open_bag(path), lambda: list(bag.messages()), lambda: list(reading), bag.counts):
            with pytest.raises(Locked, match=r"run_0\.db3 is locked: another program writes to it\. Ask again"):
                ask()
        writer.execute("ROLLBACK")
    assert list(bag.messages()) == messages and not (bag.problems or bag.holes) and read == messages[:1]


@pytest.mark.parametrize("newest_first", [False, True])
def test_a_database_can_be_written_between_the_messages_that_are_read(
    tmp_path: Path, open_bag: OpenBag, newest_first: bool
) -> None:
    path = tmp_path / "run_0.db3"
    messages = database(path, 3000)
    read: list[Message] = []
    with closing(sqlite3.connect(path, timeout=0)) as writer:
        for number, message in enumerate(open_bag(path).messages(newest_first=newest_first)):
            read.append(message)
            if number % 500 == 0:
                with writer:
                    writer.execute("UPDATE messages SET topic_id = topic_id WHERE timestamp = 1000")
    assert read == (messages[::-1] if newest_first else messages)


def test_a_database_without_an_index_is_read(tmp_path: Path, open_bag: OpenBag) -> None:
    path = tmp_path / "run_0.db3"
    messages = database(path, 3000)
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("DROP INDEX timestamp_idx")
        connection.commit()
    assert list(open_bag(path).messages()) == messages
