"""The life of a recording: nothing is recorded on that nobody knows of, and a robot that is late is waited for."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import anyio
import pytest

from ros2_mcp.bags.bag import Bag
from ros2_mcp.bags.recorder import Recorder
from ros2_mcp.bags.stored import StoredTopic
from ros2_mcp.bags.writer import BagWriter
from ros2_mcp.guard.policy import Policy
from ros2_mcp.guard.policy_file import compiled, document_of
from ros2_mcp.model.errors import BadInput, NotFound, TimedOut
from ros2_mcp.model.samples import Sample
from ros2_mcp.ops.memory import bags
from ros2_mcp.ops.memory import record as recording
from ros2_mcp.ops.memory.bag_store import BLACK_BOX, BagStore
from ros2_mcp.ops.memory.record import BlackBox, Recording, RecordRequest, keep_black_box
from ros2_mcp.ops.sources.bag import open_bag
from ros2_mcp.ops.sources.selection import Selection
from ros2_mcp.ops.topics import stats as timing
from ros2_mcp.robot import Robot
from ros2_mcp.settings import Settings
from support.made_bridge import NUMBER, MadeBridge, robot_of
from support.tasks import soon

SECOND = 1_000_000_000


@pytest.fixture(autouse=True)
def no_thread_records_on() -> Iterator[None]:
    yield
    assert not [each for each in threading.enumerate() if each.name.startswith("recording")]


async def test_a_recording_that_is_cancelled_before_it_began_is_ended(
    tmp_path: Path, bridge: MadeBridge, robot: Robot
) -> None:
    scope = anyio.CancelScope()

    async def look() -> None:
        asyncio.get_running_loop().call_later(0.1, scope.cancel)
        await asyncio.sleep(1000)

    bridge.topics = look
    with scope:  # as the MCP server cancels: again and again
        await recording.start(robot, robot.session(), BagStore(tmp_path), RecordRequest())
    assert scope.cancelled_caught
    [begun] = robot.jobs.all(Recording)
    assert not begun.is_running
    assert (tmp_path / begun.report().bag / "metadata.yaml").exists()


async def test_a_recording_that_is_cancelled_while_its_folder_is_made_never_begins(
    tmp_path: Path, bridge: MadeBridge, robot: Robot
) -> None:
    bridge.topics = lambda: asyncio.sleep(1000)
    starting = asyncio.create_task(recording.start(robot, robot.session(), BagStore(tmp_path), RecordRequest()))
    while not list(tmp_path.iterdir()):
        await asyncio.sleep(0)
    starting.cancel()
    with pytest.raises(asyncio.CancelledError):
        await starting
    [begun] = robot.jobs.all(Recording)
    assert not begun.has_begun and not begun.is_running

    assert len(list(tmp_path.glob("*/metadata.yaml"))) == 1


async def test_a_recording_that_fails_to_begin_for_another_reason_is_ended(
    tmp_path: Path, bridge: MadeBridge, robot: Robot
) -> None:
    bridge.topics = lambda: [["not", "as", "foreseen"]]
    with pytest.raises(TypeError, match="TopicRow"):
        await recording.start(robot, robot.session(), BagStore(tmp_path), RecordRequest())
    assert not robot.jobs.running(Recording)
    [failed] = (await recording.status(robot)).recordings
    assert failed.state == "failed" and "TopicRow" in failed.reason


async def test_a_recording_whose_folder_cannot_be_made_says_so(tmp_path: Path, robot: Robot) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(BadInput, match="cannot be written"):
        await recording.start(robot, robot.session(), BagStore(tmp_path / "file"), RecordRequest())
    [failed] = (await recording.status(robot)).recordings
    assert (failed.state, failed.bag, failed.messages) == ("failed", "", 0)


async def test_the_black_box_looks_again_if_its_first_look_fails(
    tmp_path: Path, bridge: MadeBridge, robot: Robot
) -> None:
    answers: list[Any] = [TimedOut("The bridge is busy.")]

    def topics() -> Any:
        if answers:
            raise answers.pop()
        return [["/said", ["a/msg/One", "a/msg/Other"], 1, 0]]

    bridge.topics, bridge.sent = topics, ("a/msg/One", "a/msg/Other")
    await keep_black_box(robot, BagStore(tmp_path), Settings(black_box=()))
    [box] = robot.jobs.running(BlackBox)
    assert box.report().bag == BLACK_BOX and list(box.report().notes) == ["The bridge is busy."]
    await soon(lambda: [topic.topic_name for topic in box.report().topics] == ["/said"])


async def test_a_topic_with_two_types_is_told_in_words_at_start_in_status_and_at_the_end(
    tmp_path: Path, bridge: MadeBridge, robot: Robot
) -> None:
    bridge.topics, bridge.sent = lambda: [["/scan", ["a/msg/One", "a/msg/Other"], 2, 0]], ("a/msg/One", "a/msg/Other")
    told = "/scan is not recorded: It has several types: a/msg/One, a/msg/Other."
    begun = await recording.start(robot, robot.session(), BagStore(tmp_path), RecordRequest(topics=["/scan"]))
    assert begun.summary().endswith(f"Z. {told}") and " 0 messages of 0 topics" in begun.summary()
    assert (await recording.status(robot)).summary()[0].endswith(told)
    assert (await recording.stop(robot, begun.recording_id)).summary().endswith(f"stopped. {told}")


async def test_a_type_that_only_a_subscriber_wants_keeps_nothing_from_being_recorded(
    tmp_path: Path, bridge: MadeBridge, robot: Robot
) -> None:
    bridge.topics, bridge.sent = lambda: [["/scan", ["a/msg/Other", NUMBER], 1, 1]], (NUMBER,)
    begun = await recording.start(robot, robot.session(), BagStore(tmp_path), RecordRequest(topics=["/scan"]))
    [scan] = begun.topics
    assert scan.topic_type == NUMBER and "several types" not in scan.error and not scan.other_types


async def test_a_topic_of_the_robot_with_the_name_of_our_own_is_told_as_not_recorded(
    tmp_path: Path, bridge: MadeBridge, robot: Robot
) -> None:
    bridge.topics = lambda: [["/agent/calls", [NUMBER], 1, 0]]
    begun = await recording.start(robot, robot.session(), BagStore(tmp_path), RecordRequest())
    assert begun.notes == ["/agent/calls records what this server does, not the topic of that name on the robot."]


async def test_the_only_recording_that_runs_is_stopped_without_its_id_and_never_the_black_box(
    tmp_path: Path, robot: Robot
) -> None:
    store = BagStore(tmp_path)
    await keep_black_box(robot, store, Settings(black_box=()))
    with pytest.raises(NotFound, match="No recording has been started"):
        await recording.stop(robot)
    first, second = [
        await recording.start(robot, robot.session(), store, RecordRequest(name=name)) for name in ("one", "two")
    ]
    with pytest.raises(BadInput, match=f"{first.recording_id}, {second.recording_id}"):
        await recording.stop(robot)
    await recording.stop(robot, first.recording_id)
    stopped = await recording.stop(robot)
    assert (stopped.recording_id, stopped.state) == (second.recording_id, "ended")
    assert len(robot.jobs.running(BlackBox)) == 1


async def test_a_recording_that_has_ended_at_its_limit_is_told_by_who_wants_to_stop_it(
    tmp_path: Path, robot: Robot
) -> None:
    begun = await recording.start(robot, robot.session(), BagStore(tmp_path), RecordRequest(max_duration_s=0.05))
    await soon(lambda: not robot.jobs.running(Recording))
    for named in ("", begun.recording_id):
        found = await recording.stop(robot, named)
        assert (found.recording_id, found.state) == (begun.recording_id, "ended")
        assert "The time of 0.05 s is over." in found.summary()


def is_on_the_disk(folder: Path) -> bool:
    with Bag(folder) as bag:
        return bag.times is not None


async def test_a_recording_that_runs_goes_on_until_now_however_long_nothing_came(tmp_path: Path) -> None:
    robot, store = robot_of(MadeBridge()), BagStore(tmp_path)
    (folder := tmp_path / "run").mkdir()
    recorder = Recorder(BagWriter(folder, "run"), folder)
    store.writes(folder, lambda: not recorder.ended)
    recorder.add_topic(StoredTopic("/said", NUMBER, None, "ros2msg", "int32 data\n"))
    silent_since_ns = time.time_ns() - 600 * SECOND
    recorder.put("/said", [Sample(silent_since_ns, 0, None, b"\0\1\0\0\7\0\0\0")])

    async def count(start: str, of: BagStore = store) -> int:
        return (await bags.read(robot, of, "run", "/said", Selection(message_limit=20), start)).count

    await soon(lambda: is_on_the_disk(folder))
    assert (await count(""), await count("last 30 s"), await count("11 min ago")) == (1, 0, 1)
    source = await open_bag(store, "run", "last 30 s")
    assert abs(source.duration_s - 30.0) < 1.0
    assert (await timing.measure(source, ["/said"])).topics[0].count == 0
    recorder.stop()
    await store.close()
    later = BagStore(tmp_path)
    assert await count("last 30 s", later) == 1
    await later.close()


async def test_a_named_topic_that_nobody_publishes_is_told(tmp_path: Path, robot: Robot) -> None:
    state = await recording.start(robot, robot.session(), BagStore(tmp_path), RecordRequest(topics=["/later"]))
    assert state.notes == ["/later: no publisher yet; recording begins within a second after one appears."]


async def test_what_is_still_being_recorded_is_not_called_damaged(tmp_path: Path, robot: Robot) -> None:
    store = BagStore(tmp_path)
    await recording.start(robot, robot.session(), store, RecordRequest(name="run"))
    assert (await bags.info(store, "run")).problems == ["It is still being recorded."]
    await robot.jobs.close()
    await store.close()
    assert (await bags.info(BagStore(tmp_path), "run")).problems == []


def test_a_recording_says_why_messages_are_missing_in_it() -> None:
    assert recording.drops_in_words(0, 0) == ""
    assert recording.drops_in_words(3, 2) == (
        "3 dropped because this server was too busy, 2 dropped because they were not written fast enough"
    )
    assert recording.drops_in_words(3, 0, is_remote=True) == (
        "3 dropped because the link was too slow, or this server too busy"
    )


async def test_what_the_policy_forbids_is_left_out_also_where_everything_is_recorded(
    tmp_path: Path, bridge: MadeBridge, robot: Robot
) -> None:
    document = document_of("policy: 1\nname: p\nallow: [{record: /**}]\nforbid: [{record: /camera/**}]", "p.yaml")
    robot.guard.policy = Policy(documents=[document], rules=compiled([document]))
    types = ["a/msg/One", "a/msg/Other"]
    bridge.topics, bridge.sent = lambda: [["/camera/image", types, 1, 0], ["/said", types, 1, 0]], tuple(types)
    begun = await recording.start(robot, robot.session(), BagStore(tmp_path), RecordRequest())
    camera, said = begun.topics
    assert camera.error == "The policy: recording /camera/image is forbidden (p line 4: forbid record /camera/**)."
    assert "several types" in said.error  # it was taken
