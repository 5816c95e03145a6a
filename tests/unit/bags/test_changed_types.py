"""A bag whose files disagree on a topic's type: the newest one's messages are read, and what is left out is told."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from mcap.writer import Writer

from ros2_mcp.bags.bag import Bag
from ros2_mcp.bags.stored import Span, StoredTopic
from ros2_mcp.bags.writer import BagWriter
from ros2_mcp.model.samples import Sample

OpenBag = Callable[[Path], Bag]
SPEED = StoredTopic("/speed", "demo/msg/Speed", None, "ros2msg", "float32 value # in m/s\nuint8 source\n")
REBUILT = StoredTopic("/speed", "demo/msg/Speed", None, "ros2msg", "uint32 source\nfloat32 value\n")
STAMPED = StoredTopic("/speed", "demo/msg/SpeedStamped", None, "ros2msg", "float32 value\n")
SAME = StoredTopic("/speed", "demo/msg/Speed", None, "ros2msg", "# How fast it is.\nfloat32  value\n\nuint8 source\n")
UNDEFINED = StoredTopic("/speed", "demo/msg/Speed")
OTHER = StoredTopic("/other", "demo/msg/Other", None, "ros2msg", "uint8 value\n")


def sample(at_ns: int) -> Sample:
    return Sample(at_ns, at_ns, at_ns, b"\0\1\0\0" + bytes([at_ns]))


def restarted(folder: Path, *runs: StoredTopic, count: int = 2) -> None:
    """A folder with a file of each run; in each one the topic as it is named, with so many messages, and another."""
    for number, topic in enumerate(runs):
        writer = BagWriter(folder, f"run_{number:02}")
        writer.add_topic(topic)
        writer.add_topic(OTHER)
        for at_ns in range(10 * number, 10 * number + count):
            writer.write(topic.name, sample(at_ns))
        writer.write(OTHER.name, sample(10 * number + 9))
        writer.end()
        writer.path.rename(folder / f"run_{number:02}.mcap")


def times(bag: Bag, *topics: str, newest_first: bool = False) -> list[int]:
    return [sample.received_ns for _, sample in bag.messages(Span(topics or None), newest_first)]


def problems(bag: Bag) -> list[str]:
    return [problem for problem in bag.problems if "metadata.yaml" not in problem]


@pytest.mark.parametrize(
    ("newest", "words"),
    [
        (REBUILT, "another definition of demo/msg/Speed, the newest of demo/msg/Speed."),
        (STAMPED, "demo/msg/Speed, the newest of demo/msg/SpeedStamped."),
    ],
)
def test_what_is_of_another_type_than_the_newest_is_left_out_and_told(
    tmp_path: Path, open_bag: OpenBag, newest: StoredTopic, words: str
) -> None:
    restarted(tmp_path, SPEED, SPEED, newest)
    bag = open_bag(tmp_path)
    assert (bag.topics["/speed"].type, bag.topics["/speed"].definition) == (newest.type, newest.definition)
    assert times(bag) == [9, 19, 20, 21, 29]
    assert times(bag, newest_first=True) == [29, 21, 20, 19, 9]
    assert times(bag, "/speed") == [20, 21]
    assert bag.last("/speed", 5) == [sample(20), sample(21)]
    assert bag.counts() == {"/speed": 2, "/other": 3}
    assert problems(bag) == [f"/speed: its messages in 2 of 3 files are left out: they are of {words}"]


@pytest.mark.parametrize("runs", [(UNDEFINED, SPEED), (SPEED, UNDEFINED), (SPEED, SAME)])
def test_a_missing_definition_or_another_comment_is_no_conflict(
    tmp_path: Path, open_bag: OpenBag, runs: tuple[StoredTopic, ...]
) -> None:
    restarted(tmp_path, *runs)
    bag = open_bag(tmp_path)
    assert bag.topics["/speed"].definition in (SPEED.definition, SAME.definition)
    assert times(bag, "/speed") == [0, 1, 10, 11]
    assert bag.counts() == {"/speed": 4, "/other": 2}
    assert problems(bag) == []


def test_where_the_newest_has_no_definition_the_last_one_that_is_known_holds(tmp_path: Path, open_bag: OpenBag) -> None:
    restarted(tmp_path, SPEED, REBUILT, UNDEFINED)
    bag = open_bag(tmp_path)
    assert bag.topics["/speed"].definition == REBUILT.definition
    assert times(bag, "/speed") == [10, 11, 20, 21]
    assert len(problems(bag)) == 1


def test_a_newest_file_that_only_names_a_topic_decides_nothing(tmp_path: Path, open_bag: OpenBag) -> None:
    restarted(tmp_path, SPEED)
    with (tmp_path / "run_99.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start("ros2", "test")
        schema = writer.register_schema(STAMPED.type, STAMPED.encoding, STAMPED.definition.encode())
        writer.register_channel(STAMPED.name, STAMPED.serialization, schema)
        writer.finish()
    bag = open_bag(tmp_path)
    assert bag.topics["/speed"].type == SPEED.type
    assert times(bag, "/speed") == [0, 1]
    assert problems(bag) == []
