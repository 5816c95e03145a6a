"""A recording on disk: what was written is read again, by us and by independent readers."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from ros2_mcp.bags.bag import Bag
from ros2_mcp.bags.qos import qos_text
from ros2_mcp.bags.recorder import Limits, Recorder
from ros2_mcp.bags.stored import Span, StoredTopic
from ros2_mcp.bags.writer import BagWriter, fresh_folder
from ros2_mcp.model.qos import QoS
from ros2_mcp.model.samples import Sample

OpenBag = Callable[[Path], Bag]
START_NS = 1_700_000_000_000_000_000
STEP_NS = 10_000_000
STRING_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
CHATTER = StoredTopic("/chatter", "std_msgs/msg/String", None, "ros2msg", "string data\n", qos_text([QoS()]))
SCAN = StoredTopic("/scan", "demo/msg/Raw", None, "ros2msg", "uint8[] data\n")


def said(number: int, size: int = 20) -> Sample:
    text = f"{number:0{size}d}".encode() + b"\0"
    data = b"\0\1\0\0" + len(text).to_bytes(4, "little") + text
    at_ns = START_NS + number * STEP_NS
    return Sample(at_ns, at_ns - 5, number + 1, data)


def record(folder: Path, count: int, *, size: int = 20, split_bytes: int = 0, flush_every: int = 50) -> list[Sample]:
    folder.mkdir()
    writer = BagWriter(folder, folder.name, split_bytes)
    writer.add_topic(CHATTER, STRING_HASH)
    writer.add_topic(SCAN)
    samples = [said(number, size) for number in range(count)]
    for number, sample in enumerate(samples):
        writer.write("/scan" if number % 10 == 0 else "/chatter", sample)
        if number % flush_every == 0:
            writer.flush()
    writer.close()
    return samples


def test_what_was_written_is_read_in_order_and_byte_for_byte(tmp_path: Path, open_bag: OpenBag) -> None:
    samples = record(tmp_path / "run", 500)
    bag = open_bag(tmp_path / "run")
    assert [sample for _, sample in bag.messages()] == samples
    assert [sample for _, sample in bag.messages(newest_first=True)] == samples[::-1]
    assert bag.counts() == {"/chatter": 450, "/scan": 50}
    assert bag.times == (samples[0].received_ns, samples[-1].received_ns)
    assert bag.problems == []


def test_independent_readers_agree_on_counts_times_and_bytes(tmp_path: Path) -> None:
    samples = record(tmp_path / "run", 300, size=2000, split_bytes=200_000)
    files = sorted((tmp_path / "run").glob("*.mcap"), key=lambda path: int(path.stem.rpartition("_")[2]))
    assert len(files) > 2
    seen = []
    for path in files:
        with path.open("rb") as file:
            reader = make_reader(file, validate_crcs=True)
            seen += [(m.log_time, m.publish_time, m.sequence, m.data) for _, _, m in reader.iter_messages()]
    assert seen == [(s.received_ns, s.source_ns, s.sequence, s.data) for s in samples]
    with AnyReader([tmp_path / "run"]) as reader:
        assert reader.message_count == len(samples)
        assert {each.topic: each.msgcount for each in reader.connections} == {"/chatter": 270, "/scan": 30}
        chatter = next(each for each in reader.connections if each.topic == "/chatter")
        assert chatter.ext.offered_qos_profiles[0].depth == 10
        assert [(at, data) for _, at, data in reader.messages()] == [(s.received_ns, s.data) for s in samples]
        assert reader.deserialize(samples[1].data, "std_msgs/msg/String").data == f"{1:02000d}"


def test_a_span_reads_only_its_time_and_topics(tmp_path: Path, open_bag: OpenBag) -> None:
    samples = record(tmp_path / "run", 500)
    bag = open_bag(tmp_path / "run")
    span = Span(("/chatter",), samples[100].received_ns, samples[120].received_ns)
    expected = [sample for number, sample in enumerate(samples[100:120], 100) if number % 10]
    assert [sample for _, sample in bag.messages(span)] == expected
    assert bag.last("/scan", 3) == [samples[470], samples[480], samples[490]]


def test_messages_of_several_files_come_in_the_order_of_time(tmp_path: Path, open_bag: OpenBag) -> None:
    samples = record(tmp_path / "run", 400, size=5000, split_bytes=150_000, flush_every=10)
    assert len(list((tmp_path / "run").glob("*.mcap"))) > 10
    assert [sample for _, sample in open_bag(tmp_path / "run").messages()] == samples


def test_a_recording_ends_at_its_limit_of_bytes_and_says_so(tmp_path: Path, open_bag: OpenBag) -> None:
    recorder = Recorder(BagWriter(tmp_path, "run"), tmp_path, Limits(max_bytes=300_000, free_floor_bytes=0))
    recorder.add_topic(CHATTER)
    recorder.put("/chatter", [said(number, 1000) for number in range(1000)])
    recorder._thread.join(60)
    assert recorder.ended == "The limit of 300000 bytes is reached."
    written = recorder.sink.counts["/chatter"]
    assert 0 < written < 1000
    recorder.put("/chatter", [said(1000, 1000)])
    assert not recorder.dropped  # what comes after the limit is none of the recording's
    assert sum(path.stat().st_size for path in tmp_path.iterdir()) < 320_000
    assert [sample for _, sample in open_bag(tmp_path).messages()] == [said(number, 1000) for number in range(written)]


def test_much_that_waits_is_written_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ros2_mcp.bags.recorder.FLUSH_S", 600.0)
    recorder = Recorder(BagWriter(tmp_path, "run"), tmp_path, Limits(max_bytes=4_000_000, free_floor_bytes=0))
    recorder.add_topic(CHATTER)
    recorder.put("/chatter", [said(0, 5_000_000)])
    recorder._thread.join(60)
    assert recorder.ended == "The limit of 4000000 bytes is reached."


def test_of_a_burst_that_has_no_room_what_fits_is_written(
    tmp_path: Path, open_bag: OpenBag, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ros2_mcp.bags.recorder.QUEUE_BYTES", 3500)
    recorder = Recorder(BagWriter(tmp_path, "run"), tmp_path, Limits(free_floor_bytes=0))
    recorder.add_topic(CHATTER)
    recorder.put("/chatter", [said(number, 1000) for number in range(10)])
    recorder.stop()
    assert recorder.dropped == {"/chatter": 7}
    assert [sample for _, sample in open_bag(tmp_path).messages()] == [said(number, 1000) for number in range(3)]


def test_a_disk_that_is_nearly_full_ends_the_recording_in_good_order(tmp_path: Path, open_bag: OpenBag) -> None:
    recorder = Recorder(BagWriter(tmp_path, "run"), tmp_path, Limits(free_floor_bytes=10**18))
    recorder.add_topic(CHATTER)
    recorder.put("/chatter", [said(0)])
    recorder._thread.join(60)
    assert recorder.failed and "must stay free" in recorder.ended
    assert [sample for _, sample in open_bag(tmp_path).messages()] == [said(0)]


def record_until_the_disk_is_full(folder: Path) -> None:
    """In a process of its own: no file of it may grow beyond 200 kB."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000))
    recorder = Recorder(BagWriter(folder, "run"), folder, Limits(free_floor_bytes=0))
    recorder.add_topic(CHATTER)
    number = 0
    while not recorder.ended:
        recorder.put("/chatter", [said(number + more, 1000) for more in range(10)])
        number += 10
        time.sleep(0.02)
    print(recorder.failed, recorder.ended)


def test_a_disk_that_takes_no_more_leaves_what_was_written(tmp_path: Path, open_bag: OpenBag) -> None:
    command = [sys.executable, __file__, str(tmp_path)]
    answer = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True).stdout
    assert answer.startswith("True Writing to the disk failed: File too large")
    bag = open_bag(tmp_path)
    read = [sample for _, sample in bag.messages()]
    assert read == [said(number, 1000) for number in range(len(read))]
    assert len(read) > 50
    assert any("was not closed" in problem for problem in bag.problems)


@pytest.fixture
def ordinary_user() -> Iterator[None]:
    """The superuser may write everywhere, and is nobody for the time of the test."""
    user = os.geteuid()
    if user == 0:
        os.seteuid(65534)
    yield
    os.seteuid(user)


def test_a_folder_that_cannot_be_written_is_an_error_at_once(tmp_path: Path, request: pytest.FixtureRequest) -> None:
    tmp_path.chmod(0o500)
    request.getfixturevalue("ordinary_user")
    with pytest.raises(PermissionError):
        fresh_folder(tmp_path, "run")


@pytest.mark.parametrize(
    ("wanted", "name"),
    [("../../etc/x", "etc_x"), ("a b", "a_b"), ("ä/ö", "recording"), (".hidden", "hidden"), ("x" * 300, "x" * 80)],
)
def test_a_recording_never_leaves_its_folder(tmp_path: Path, wanted: str, name: str) -> None:
    folder = fresh_folder(tmp_path, wanted)
    assert folder.parent == tmp_path
    assert folder.name.startswith(name)
    assert fresh_folder(tmp_path, wanted) != folder


def test_of_a_bag_that_grows_only_what_has_changed_is_looked_through_again(tmp_path: Path, open_bag: OpenBag) -> None:
    writer = BagWriter(tmp_path, "run", split_bytes=20_000)
    writer.add_topic(CHATTER)

    def write(*numbers: int) -> None:
        for number in numbers:
            writer.write("/chatter", said(number, 5000))
            writer.flush()

    write(*range(10))
    former = open_bag(tmp_path)
    write(*range(10, 12))
    grown = Bag(tmp_path, former)
    writer.close()
    same = [path for path, file in grown.known_files().items() if former.known_files().get(path) is file]
    assert sorted(path.name for path in same) == sorted(path.name for path in former.known_files())[:-1]
    assert [sample for _, sample in grown.messages()] == [said(number, 5000) for number in range(12)]
    assert [sample for _, sample in former.messages()] == [said(number, 5000) for number in range(10)]


if __name__ == "__main__":
    record_until_the_disk_is_full(Path(sys.argv[1]))
