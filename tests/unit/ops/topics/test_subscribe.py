"""What a read of a topic says: pictures and how many, times, and where it is from; and its text, which is short."""

from __future__ import annotations

import json
from collections.abc import AsyncIterator
from dataclasses import replace
from pathlib import Path

import pytest

from ros2_mcp.bags.stored import StoredTopic
from ros2_mcp.bags.writer import BagWriter
from ros2_mcp.mcp.binding import answer, bind
from ros2_mcp.model.errors import BadValue
from ros2_mcp.model.samples import Sample
from ros2_mcp.ops.memory import bags
from ros2_mcp.ops.memory.bag_store import BagStore
from ros2_mcp.ops.memory.messages import get_messages
from ros2_mcp.ops.results.results import AnswerBytes, silent
from ros2_mcp.ops.sources.bag import BagSource, open_bag
from ros2_mcp.ops.sources.kinds import Sources
from ros2_mcp.ops.sources.live import Live
from ros2_mcp.ops.sources.recorded_robot import recorded_robot
from ros2_mcp.ops.sources.selection import Selection
from ros2_mcp.ops.sources.source import SourceRequest
from ros2_mcp.ops.topics import subscribe as reading
from ros2_mcp.tools import DECLARED
from support.made_bridge import MadeBridge, robot_of
from support.made_windows import START_NS, encoded

PICTURE = {"height": 2, "width": 2, "encoding": "mono8", "step": 2, "data": [0, 50, 100, 150] * 20}
POSE = {"header": {"frame_id": "map"}, "pose": {"covariance": [0.25] * 36}}
TYPES = {
    "/camera": "sensor_msgs/msg/Image",
    "/pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "/tf": "tf2_msgs/msg/TFMessage",
}


def transforms(*children: str) -> dict[str, object]:
    return {"transforms": [{"child_frame_id": child, "header": {"frame_id": "odom"}} for child in children]}


@pytest.fixture
async def bag(tmp_path: Path) -> AsyncIterator[BagSource]:
    """Six messages of each topic, one each half second; base_link is in every second one of /tf."""
    (tmp_path / "run").mkdir()
    writer = BagWriter(tmp_path / "run", "run")
    for name, type_name in TYPES.items():
        writer.add_topic(StoredTopic(name, type_name, None, "ros2msg", ""))
    for number in range(6):
        pose = {**POSE, "pose": {**POSE["pose"], "pose": {"position": {"x": number / 3}}}}
        children = ("wheel", "base_link") if number % 2 else ("wheel",)
        for name, value in (("/camera", PICTURE), ("/pose", pose), ("/tf", transforms(*children))):
            at_ns = START_NS + number * 500_000_000
            writer.write(name, Sample(at_ns, 0, number, encoded(TYPES[name], value)))
    writer.close()
    store = BagStore(tmp_path)
    yield await open_bag(store, "run")
    await store.close()


async def test_a_read_says_of_how_many_messages_pictures_are_shown_and_gives_no_advice_on_their_bytes(
    bag: BagSource,
) -> None:
    six = await reading.read(bag, "/camera", "", Selection(message_limit=6))
    assert (six.count, len(six.images)) == (6, 4)
    assert "Pictures of 4 of the 6 messages are shown (numbers 1, 3, 4, 6)" in six.note
    assert "Summarised" not in six.note and six.truncated == ["data"]
    few = await reading.read(bag, "/camera", "", Selection(message_limit=4))
    assert (len(few.images), "Pictures of" in few.note) == (4, False)


async def test_times_count_from_the_recordings_beginning_which_is_said_once(bag: BagSource) -> None:
    last = await reading.read(bag, "/pose", "", Selection(message_limit=2))
    assert (last.start, last.times_s) == ("2023-11-14T22:13:20.000000Z", [2.0, 2.5])
    echoed = await reading.echo(bag, "/pose", "", Selection())
    assert (echoed.received_at, echoed.seconds_from_start) == ("2023-11-14T22:13:22.500000Z", 2.5)


def test_a_live_read_says_how_long_it_took_and_the_bound_apart() -> None:
    live = Live(robot_of(MadeBridge()), 5.0)
    assert live.words_after(0.26) == "live, 0.26 s of at most 5 s"
    assert live.words_after(5.001) == live.words == "live, 5 s"


async def test_the_text_says_once_what_all_messages_share_and_the_structured_content_is_whole(bag: BagSource) -> None:
    read = await reading.read(bag, "/pose", "", Selection(message_limit=6))
    result = answer(read)
    text: str = result.content[0].text  # type: ignore[union-attr]
    lines = text.splitlines()
    at = next(number for number, line in enumerate(lines) if line.startswith("messages (6), the first whole"))
    assert "6 messages" in lines[0]
    assert json.loads(lines[at + 1]) == read.messages[0]
    assert lines[at + 2] == "times_s | pose.pose.position.x"
    rows = [line.split(" | ") for line in lines[at + 3 : at + 9]]
    assert [json.loads(x) for _, x in rows] == [number / 3 if number != 3 else 1 for number in range(6)]
    assert not [name for name in ("note", "error", "truncated", "picture") if name in text]
    structured = result.structured_content
    assert structured and structured["messages"] == read.messages and "note" not in structured
    assert len(text) * 2 < len(json.dumps(structured))


BASE = 'transforms[child_frame_id == "base_link"]'


async def test_messages_without_an_element_that_the_fields_ask_for_are_left_out_and_told(bag: BagSource) -> None:
    last = await reading.read(bag, "/tf", "", Selection(message_limit=2, fields=[f"{BASE}.header.frame_id"]))
    assert last.messages == [{f"{BASE}.header.frame_id": ["odom"]}] * 2
    assert (last.times_s, last.dropped) == ([1.5, 2.5], 0)
    assert "No such element in 3 other messages." in last.note
    (whole,) = (await reading.read(bag, "/tf", "", Selection(fields=[BASE]))).messages
    assert [each["child_frame_id"] for each in whole[BASE]] == ["base_link"]
    nowhere = await reading.read(bag, "/tf", "", Selection(fields=['transforms[child_frame_id == "arm"]']))
    assert nowhere.count == 0 and "6 other messages" in nowhere.note
    with pytest.raises(BadValue, match="cannot be applied to"):
        await reading.read(bag, "/tf", "", Selection(fields=["transforms[child_frame_id == 3]"]))


async def test_reads_with_a_filter_and_a_limit_say_how_to_read_on(bag: BagSource, tmp_path: Path) -> None:
    asked = Selection(message_limit=2, fields=[BASE])
    last = await reading.read(bag, "/tf", "", asked)
    assert last.note == "No such element in 3 other messages."
    store = BagStore(tmp_path, subject=tmp_path / "run")
    robot = recorded_robot(store, [AnswerBytes(32_000)])
    first = await bags.read(robot, store, "run", "/tf", asked, start="0 s in")
    assert first.times_s == [0.5, 1.5]
    assert "There may be later messages: to read them, give start" in first.note and "No such element" in first.note
    past = await get_messages(Sources(robot, store), "/tf", "", SourceRequest(), replace(asked, message_limit=1))
    assert [each["child_frame_id"] for each in past.messages[0][BASE]] == ["base_link"]
    early = await get_messages(
        Sources(robot, store), "/tf", "", SourceRequest(end="2.2 s in"), replace(asked, message_limit=1)
    )
    assert early.times_s == [1.5] and "1 other message" not in early.note and "No such element" in early.note
    await store.close()


async def test_each_of_several_topics_may_have_fields_of_its_own(bag: BagSource, tmp_path: Path) -> None:
    tool = next(each for each in DECLARED if each.name == "ros2_subscribe_multiple_topics")
    robot, store = robot_of(MadeBridge()), BagStore(tmp_path)
    topics = [{"name": "/tf"}, {"name": "/pose", "fields": ["header.frame_id"]}]
    called = await bind(tool, robot, store).call({"topics": topics, "fields": [BASE], "bag": bag.name}, silent)
    assert called.structured_content
    tf, pose = called.structured_content["topics"]
    assert list(tf["messages"][0]) == [BASE] and pose["messages"] == [{"header.frame_id": "map"}]
    await store.close()


async def test_fields_for_several_topics_are_those_that_each_type_has_and_the_others_are_told(
    bag: BagSource, tmp_path: Path
) -> None:
    tool = next(each for each in DECLARED if each.name == "ros2_subscribe_multiple_topics")
    robot, store = robot_of(MadeBridge()), BagStore(tmp_path)
    fields = ["header.frame_id", "pose.pose.position.x"]
    asked = {"topics": [{"name": name} for name in ("/pose", "/camera", "/tf")], "fields": fields, "bag": bag.name}
    called = await bind(tool, robot, store).call(asked, silent)
    assert called.structured_content
    pose, camera, tf = called.structured_content["topics"]
    assert list(pose["messages"][0]) == fields and "no such field" not in pose.get("note", "")
    assert camera["messages"] == [{"header.frame_id": ""}] and "error" not in camera
    assert "sensor_msgs/msg/Image has no such field: pose.pose.position.x." in camera["note"]
    assert "has no field 'header'" in tf["error"]
    own = {**asked, "topics": [{"name": "/pose"}, {"name": "/camera", "fields": fields}]}
    called = await bind(tool, robot, store).call(own, silent)
    assert called.structured_content and "has no field 'pose'" in called.structured_content["topics"][1]["error"]
    await store.close()
