"""The black box's ring of files: it keeps the newest, within its bytes, and in each file what late readers need."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from ros2_mcp.bags.bag import Bag
from ros2_mcp.bags.qos import qos_text
from ros2_mcp.bags.recorder import Limits, Recorder
from ros2_mcp.bags.ring import MOST_MESSAGES, LatchedTopic, RingWriter
from ros2_mcp.bags.stored import StoredTopic
from ros2_mcp.bags.writer import MESSAGE_BYTES
from ros2_mcp.model.qos import QoS
from ros2_mcp.model.samples import Sample

OpenBag = Callable[[Path], Bag]
RING_BYTES = 400_000
PART_BYTES = RING_BYTES // 16
START_NS = 1_700_000_000_000_000_000
CHATTER = StoredTopic("/chatter", "demo/msg/Raw", None, "ros2msg", "uint8[] data\n", qos_text([QoS()]))
MAP = replace(CHATTER, name="/map", qos=qos_text([QoS(durability="transient_local")]))
TF_STATIC = replace(MAP, name="/tf_static")


def said(number: int, size: int = 20) -> Sample:
    at_ns = START_NS + number * 10_000_000
    return Sample(at_ns, at_ns - 5, number + 1, b"\0\1\0\0" + f"{number:0{size}d}".encode())


def fill(ring: RingWriter, folder: Path, first: int, last: int) -> None:
    """Chatter of about a kilobyte each, a few messages at a time; at no time the ring is larger than it may be."""
    for number in range(first, last):
        ring.write("/chatter", said(number, 1000))
        if number % 5 == 0:
            ring.flush()
            assert sum(path.stat().st_size for path in folder.iterdir()) <= RING_BYTES


def files(folder: Path) -> list[Path]:
    return sorted(folder.glob("*.mcap"))


def test_a_ring_stays_within_its_bytes_and_keeps_the_newest(tmp_path: Path, open_bag: OpenBag) -> None:
    ring = RingWriter(tmp_path, RING_BYTES, max_age_s=3600)
    ring.add_topic(CHATTER)
    ring.add_topic(MAP)
    ring.write("/map", said(0))
    fill(ring, tmp_path, 1, 2000)
    ring.close()
    bag = open_bag(tmp_path)
    newest = bag.last("/chatter", 100)
    assert newest == [said(number, 1000) for number in range(1900, 2000)]
    assert said(0) in bag.last("/map", 1)


def test_latched_messages_leave_the_history_where_it_is_and_say_if_they_are_too_large(
    tmp_path: Path, open_bag: OpenBag
) -> None:
    ring = RingWriter(tmp_path, RING_BYTES, max_age_s=3600)
    silent = [replace(MAP, name=f"/silent_{number}") for number in range(100)]
    for topic in (CHATTER, MAP, TF_STATIC, *silent):
        ring.add_topic(topic)
    ring.write("/tf_static", said(0))
    ring.write("/map", said(1, 2 * PART_BYTES))
    fill(ring, tmp_path, 2, 1000)
    ring.close()
    assert len(ring.notes) == 1
    assert ring.notes[0].startswith("/map is latched, but with 5")
    for path in files(tmp_path):
        assert open_bag(path).last("/tf_static", 1) == [said(0)]
    assert len(open_bag(tmp_path).last("/chatter", 250)) == 250


@pytest.mark.parametrize(("topics", "size"), [(0, 0), *((2, size) for size in range(1000, 6000, 400)), (400, 5)])
def test_latched_messages_fit_in_the_ring_with_a_long_history(
    tmp_path: Path, open_bag: OpenBag, topics: int, size: int
) -> None:
    ring = RingWriter(tmp_path, RING_BYTES, max_age_s=3600)
    ring.add_topic(CHATTER)
    for number in range(topics):
        ring.add_topic(replace(MAP, name=f"/map_{number:03}"))
        ring.write(f"/map_{number:03}", said(number, size))
    fill(ring, tmp_path, 1000, 2000)
    ring.close()
    newest = files(tmp_path)[-1]
    carried = [topic for topic in open_bag(newest).topics if topic.startswith("/map")]
    assert len(carried) + len(ring.notes) == topics
    assert carried or not topics
    for path in files(tmp_path)[:-1]:
        assert open_bag(path).counts()["/chatter"] > PART_BYTES // 1100
    assert open_bag(tmp_path).last("/chatter", 200) == [said(number, 1000) for number in range(1800, 2000)]


def test_the_last_messages_of_several_publishers_are_in_every_file(tmp_path: Path, open_bag: OpenBag) -> None:
    ring = RingWriter(tmp_path, RING_BYTES, max_age_s=3600)
    ring.add_topic(CHATTER)
    ring.add_topic(TF_STATIC)
    transforms = [said(number) for number in range(3)]
    for sample in transforms:
        ring.write("/tf_static", sample)
    again = replace(transforms[0], received_ns=said(3).received_ns)
    ring.write("/tf_static", again)
    fill(ring, tmp_path, 4, 1000)
    ring.close()
    assert len(files(tmp_path)) > 8
    for path in files(tmp_path):
        assert open_bag(path).last("/tf_static", 10) == [*transforms[1:], again]


def test_of_a_latched_topic_the_last_message_is_kept_and_older_ones_within_bounds() -> None:
    topic = LatchedTopic(20 * (MESSAGE_BYTES + 100))
    for number in range(100):
        topic.add(Sample(number, 0, None, number.to_bytes(100, "little")))
    assert [sample.received_ns for sample in topic.samples] == list(range(80, 100))
    for number in range(100):
        topic.add(Sample(number, 0, None, bytes([number])))
    assert [sample.received_ns for sample in topic.samples] == list(range(100 - MOST_MESSAGES, 100))
    topic.add(Sample(1000, 0, None, bytes(5000)))
    assert [sample.received_ns for sample in topic.samples] == [1000]
    assert topic.bytes == MESSAGE_BYTES + 5000


def test_a_recorder_hands_on_what_its_ring_has_to_say(tmp_path: Path) -> None:
    ring = RingWriter(tmp_path, RING_BYTES, max_age_s=3600)
    recorder = Recorder(ring, tmp_path, Limits(free_floor_bytes=0))
    recorder.add_topic(MAP)
    recorder.put("/map", [said(0, 2 * PART_BYTES)])
    recorder.stop()
    assert "too large" in "".join(recorder.notes)


def test_the_names_of_the_files_are_in_the_order_of_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ros2_mcp.bags.ring.time.time_ns", lambda: 5_999_999_999)
    RingWriter(tmp_path, RING_BYTES, max_age_s=3600).close()
    assert [path.name for path in files(tmp_path)] == ["box_19700101T000005_999999999_0.mcap"]


def test_latched_messages_stand_in_every_file_of_a_ring_and_are_read_once(tmp_path: Path, open_bag: OpenBag) -> None:
    ring = RingWriter(tmp_path, max_bytes=RING_BYTES, max_age_s=3600)
    ring.add_topic(CHATTER)
    ring.add_topic(MAP)
    written = [("/map", said(0)), ("/map", said(1))]
    written += [("/chatter", said(number, 10_000)) for number in range(2, 12)]
    for topic, sample in written:
        ring.write(topic, sample)
        ring.flush()
    ring.close()
    bag = open_bag(tmp_path)
    assert bag.counts()["/map"] > 2  # with the copies
    assert list(bag.messages()) == written
    assert list(bag.messages(newest_first=True)) == written[::-1]
