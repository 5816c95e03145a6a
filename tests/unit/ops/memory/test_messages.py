"""Messages of the past: who is asked, who is not, and what is said of those that were not read."""

from __future__ import annotations

import asyncio
import re
import time
from collections.abc import AsyncIterator, Callable
from dataclasses import replace
from pathlib import Path

import pytest

from ros2_mcp.bags.qos import qos_text
from ros2_mcp.bags.recorder import Recorder
from ros2_mcp.bags.ring import RingWriter
from ros2_mcp.bags.stored import StoredTopic
from ros2_mcp.bags.writer import BagWriter
from ros2_mcp.mcp.binding import bind
from ros2_mcp.model.errors import BadData, NotFound, UnknownInterface
from ros2_mcp.model.qos import QoS
from ros2_mcp.model.samples import Sample
from ros2_mcp.ops.memory import bags
from ros2_mcp.ops.memory import messages as history
from ros2_mcp.ops.memory.bag_store import BLACK_BOX, BagStore
from ros2_mcp.ops.memory.messages import StoredMessages
from ros2_mcp.ops.results.results import AnswerBytes
from ros2_mcp.ops.sources.kinds import Sources
from ros2_mcp.ops.sources.recorded_robot import recorded_robot
from ros2_mcp.ops.sources.selection import Selection
from ros2_mcp.ops.sources.source import SourceRequest
from ros2_mcp.tools import DECLARED
from support.made_windows import encoded

START_NS = 1_700_000_000_123_456_789
SECOND = 10**9
COUNT = StoredTopic("/count", "std_msgs/msg/Int32", None, "ros2msg", "int32 data\n")
RAW = StoredTopic("/raw", "std_msgs/msg/String", None, "ros2msg", "string data\n")
ODD = StoredTopic("/count", "odd_msgs/msg/Odd")


def number_at(value: int, seconds: float = 0.0) -> Sample:
    return Sample(START_NS + round(seconds * SECOND), 0, value, encoded("std_msgs/msg/Int32", {"data": value}))


def large(number: int) -> Sample:
    return Sample(START_NS + number * SECOND, 0, number + 1, encoded("std_msgs/msg/String", {"data": "x" * 2_000_000}))


def make_bag(folder: Path, topic: StoredTopic, *samples: Sample) -> None:
    folder.mkdir()
    writer = BagWriter(folder, folder.name)
    writer.add_topic(topic)
    for sample in samples:
        writer.write(topic.name, sample)
        writer.flush()
    writer.close()


class Asker:
    """A server's memory; its robot is a recording, or none at all."""

    def __init__(self, folder: Path, subject: Path | None = None) -> None:
        self.store = BagStore(folder, subject=subject)
        self.robot = recorded_robot(self.store, [AnswerBytes(32_000)])

    async def get(self, topic: str = "/count", number: int = 0, **asked: str) -> StoredMessages:
        selection = Selection(message_limit=number or None)
        request = SourceRequest(**asked, names=("time_start", "time_end"))
        return await history.get_messages(Sources(self.robot, self.store), topic, "", request, selection)

    async def read(self, bag: str, topic: str, limit: int = 20, every_n: int = 1, **asked: str) -> bags.BagMessages:
        selection = Selection(message_limit=limit, every_n=every_n)
        return await bags.read(self.robot, self.store, bag, topic, selection, **asked)

    async def open(self, *names: str) -> None:
        for name in names:
            await bags.info(self.store, name)

    def records(self, folder: Path) -> Recorder:
        recorder = Recorder(RingWriter(folder, 10**8, 3600), folder)
        recorder.add_topic(COUNT)
        self.store.writes(folder, lambda: not recorder.ended)
        return recorder

    async def close(self) -> None:
        await self.store.close()


@pytest.fixture
async def asker(tmp_path: Path, anyio_backend: str) -> AsyncIterator[Callable[..., Asker]]:
    made: list[Asker] = []

    def make(subject: str = "") -> Asker:
        made.append(Asker(tmp_path, tmp_path / subject if subject else None))
        return made[-1]

    yield make
    for each in made:
        await each.close()


def values(answer: StoredMessages | bags.BagMessages) -> list[int]:
    return [each["data"] for each in answer.messages]


async def test_the_black_box_of_a_former_server_is_silent_until_it_is_opened(
    tmp_path: Path, asker: Callable[..., Asker]
) -> None:
    make_bag(tmp_path / BLACK_BOX, COUNT, number_at(1))
    agent = asker()
    with pytest.raises(NotFound, match="No messages of"):
        await agent.get()
    await agent.open("black box")
    assert "the bag" in (await agent.get()).source


async def test_how_messages_could_be_kept_is_told_as_far_as_it_is_not_so_already(
    tmp_path: Path, asker: Callable[..., Asker]
) -> None:
    agent = asker()
    with pytest.raises(NotFound) as refused:
        await agent.get()
    assert "The option --black-box keeps" in refused.value.hint
    box = agent.records(tmp_path / BLACK_BOX)
    with pytest.raises(NotFound) as refused:
        await agent.get("/other")
    assert "The black box of this server does not keep this topic" in refused.value.hint
    box.stop()


async def test_a_bag_that_is_the_robot_answers_before_an_old_black_box(
    tmp_path: Path, asker: Callable[..., Asker]
) -> None:
    make_bag(tmp_path / BLACK_BOX, COUNT, number_at(1))
    make_bag(tmp_path / "robot", COUNT, number_at(2))
    answer = await asker("robot").get()
    assert (answer.source, values(answer)) == ("the bag robot", [2])


async def test_the_black_box_answers_first_while_it_runs_and_last_when_it_has_ended(
    tmp_path: Path, asker: Callable[..., Asker]
) -> None:
    agent = asker()
    box, mine = agent.records(tmp_path / BLACK_BOX), agent.records(tmp_path / "mine")
    for value, recorder in enumerate((box, mine)):
        recorder.put("/count", [number_at(value)])
    mine.stop()
    deadline = time.monotonic() + 30
    while (await agent.get()).source != f"this server's recording {BLACK_BOX}":
        assert time.monotonic() < deadline, "the black box that runs was never asked first"
        await asyncio.sleep(0.05)
    box.stop()
    answer = await agent.get()
    assert (answer.source, values(answer)) == ("this server's recording mine", [1])


async def test_a_damaged_bag_and_one_of_an_unknown_type_keep_no_other_from_being_asked(
    tmp_path: Path, asker: Callable[..., Asker]
) -> None:
    for name in ("good", "damaged", "robot"):
        make_bag(tmp_path / name, COUNT, *([] if name == "robot" else [number_at(3)]))
    make_bag(tmp_path / "odd", ODD, number_at(3))
    agent = asker("robot")
    await agent.open("good", "damaged", "odd")
    (tmp_path / "damaged" / "damaged_0.mcap").write_bytes(b"nonsense")
    answer = await agent.get()
    assert (answer.source, values(answer)) == ("the bag good", [3])
    assert "damaged cannot be read" in answer.note and "odd_msgs/msg/Odd" in answer.note

    alone = asker("robot")
    await alone.open("odd")
    with pytest.raises(UnknownInterface, match="odd_msgs/msg/Odd"):
        await alone.get()


async def test_earlier_messages_that_were_not_read_are_told_and_how_to_get_them(
    tmp_path: Path, asker: Callable[..., Asker]
) -> None:
    make_bag(tmp_path / "robot", RAW, *(large(number) for number in range(80)))
    agent = asker("robot")
    seen = 0
    asked: dict[str, str] = {}
    while True:
        answer = await agent.get("/raw", **asked)
        seen += answer.found
        if "There are earlier" not in answer.note:
            break
        assert answer.found == 31
        asked = {"end": re.findall(r"time_end (\S+)\.", answer.note)[0]}
    assert seen == 80
    assert "earlier" not in (await agent.get("/raw", number=2)).note

    read = await agent.read("robot", "/raw", limit=60)
    end = re.findall(r"There are earlier messages: to read them, give end (\S+)\.", read.note)[0]
    assert "There are earlier" in (await agent.read("robot", "/raw", end=end, limit=10)).note
    assert "There are earlier" not in (await agent.read("robot", "/raw", end=end, limit=60, every_n=2)).note


async def test_a_bag_is_read_on_from_where_the_answer_says(tmp_path: Path, asker: Callable[..., Asker]) -> None:
    make_bag(tmp_path / "robot", COUNT, *(number_at(value, value / 7) for value in range(10)))
    agent = asker("robot")
    first = await agent.read("robot", "/count", start="first 0 s", limit=6)
    start = re.findall(r"There are later messages: to read them, give start (\S+)\.", first.note)[0]
    rest = await agent.read("robot", "/count", start=start, limit=6)
    assert values(first) + values(rest) == list(range(10)) and rest.note == ""


async def test_only_the_messages_that_are_shown_are_decoded(tmp_path: Path, asker: Callable[..., Asker]) -> None:
    damaged = [Sample(START_NS + number, 0, number, b"\0\1\0\0") for number in (3, 5_000, 9_999)]
    samples = [number_at(value, value / SECOND) for value in range(10_000)]
    for each in damaged:
        samples[each.received_ns - START_NS] = each
    make_bag(tmp_path / "robot", COUNT, *samples)
    answer = await asker("robot").get()
    assert values(answer)[0] == 0 and values(answer)[-1] == 9_998 and 5 < answer.count < 1000
    assert "1 message that cannot be decoded" in answer.note


async def test_messages_of_which_none_can_be_read_are_an_error(tmp_path: Path, asker: Callable[..., Asker]) -> None:
    make_bag(tmp_path / "robot", COUNT, Sample(START_NS, 0, 1, b"\0\1\0\0"))
    with pytest.raises(BadData, match="has 1 message of /count, but none"):
        await asker("robot").get()


async def test_a_latched_message_that_every_file_of_a_ring_has_is_shown_once(
    tmp_path: Path, asker: Callable[..., Asker]
) -> None:
    ring = RingWriter(tmp_path / "robot", 16 * 7000, 3600)
    ring.add_topic(replace(COUNT, name="/mode", qos=qos_text([QoS(durability="transient_local")])))
    ring.add_topic(RAW)
    ring.write("/mode", number_at(7))
    for number in range(3):
        ring.write("/raw", Sample(START_NS + number, 0, number + 1, bytes(7000)))
        ring.flush()  # and begins the next file
    ring.write("/mode", number_at(7, 1.0))
    ring.close()
    assert len(list((tmp_path / "robot").iterdir())) == 4
    agent = asker("robot")
    assert values(await agent.get("/mode")) == values(await agent.read("robot", "/mode")) == [7, 7]


async def test_limit_is_another_name_for_the_number_of_messages(tmp_path: Path, asker: Callable[..., Asker]) -> None:
    make_bag(tmp_path / "robot", COUNT, *(number_at(value, value) for value in range(5)))
    agent = asker("robot")
    tool = bind(next(each for each in DECLARED if each.name == "ros2_get_messages"), agent.robot, agent.store)

    async def nobody(done: float, whole: float, line: str) -> None:
        pass

    answer = (await tool.call({"topic_name": "/count", "limit": 2}, nobody)).structured_content
    assert answer and [each["data"] for each in answer["messages"]] == [3, 4]
