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
from ros2_mcp.model.errors import TimedOut
from ros2_mcp.model.samples import Sample
from ros2_mcp.ops import bags, recording, timing
from ros2_mcp.ops.black_box import keep_black_box
from ros2_mcp.ops.memory import BLACK_BOX, Memory
from ros2_mcp.ops.recorded import open_bag
from ros2_mcp.ops.recording import Recording, Wanted, recordings
from ros2_mcp.ops.selection import Selection
from ros2_mcp.settings import Settings
from support.made_bridge import NUMBER, MadeBridge, robot_of, soon

SECOND = 1_000_000_000


@pytest.fixture(autouse=True)
def no_thread_records_on() -> Iterator[None]:
    yield
    assert not [each for each in threading.enumerate() if each.name.startswith("recording")]


async def test_a_recording_that_is_cancelled_before_it_began_is_ended(tmp_path: Path) -> None:
    bridge, memory, scope = MadeBridge(), Memory(tmp_path), anyio.CancelScope()

    async def look() -> None:
        asyncio.get_running_loop().call_later(0.1, scope.cancel)
        await asyncio.sleep(1000)

    bridge.topics = look
    with scope:  # as the MCP server cancels: again and again
        await recording.start(robot_of(bridge), memory, Wanted())
    assert scope.cancelled_caught
    [begun] = recordings(memory).values()
    await soon(lambda: not begun.is_running)
    assert (tmp_path / begun.id / "metadata.yaml").exists()


async def test_a_recording_that_is_cancelled_while_its_folder_is_made_never_begins(tmp_path: Path) -> None:
    memory = Memory(tmp_path)
    starting = asyncio.create_task(recording.start(robot_of(MadeBridge()), memory, Wanted()))
    await asyncio.sleep(0)
    starting.cancel()
    with pytest.raises(asyncio.CancelledError):
        await starting
    assert not memory.running

    assert len(list(tmp_path.glob("*/metadata.yaml"))) == 1


async def test_a_recording_that_fails_to_begin_for_another_reason_is_ended(tmp_path: Path) -> None:
    bridge, memory = MadeBridge(), Memory(tmp_path)
    bridge.topics = lambda: [["not", "as", "foreseen"]]
    with pytest.raises(TypeError, match="TopicRow"):
        await recording.start(robot_of(bridge), memory, Wanted())
    assert not any(each.is_running for each in recordings(memory).values())


async def test_the_black_box_looks_again_if_its_first_look_fails(tmp_path: Path) -> None:
    answers: list[Any] = [TimedOut("The bridge is busy.")]

    def topics() -> Any:
        if answers:
            raise answers.pop()
        return [["/said", ["a/msg/One", "a/msg/Other"], 1, 0]]

    bridge, memory = MadeBridge(), Memory(tmp_path)
    bridge.topics = topics
    await keep_black_box(robot_of(bridge), memory, Settings(black_box=()))
    box = recordings(memory)[BLACK_BOX]
    assert box.is_running and list(box.state().notes) == ["The bridge is busy."]
    await soon(lambda: [each.topic_name for each in box.state().topics] == ["/said"])
    await memory.close()


def is_on_the_disk(folder: Path) -> bool:
    with Bag(folder) as bag:
        return bag.times is not None


async def test_a_recording_that_runs_goes_on_until_now_however_long_nothing_came(tmp_path: Path) -> None:
    robot, memory = robot_of(MadeBridge()), Memory(tmp_path)
    (folder := tmp_path / "run").mkdir()
    recorder = Recorder(BagWriter(folder, "run"), folder)
    memory.running["run"] = Recording(robot, "run", folder, recorder, Wanted())
    recorder.add_topic(StoredTopic("/said", NUMBER, None, "ros2msg", "int32 data\n"))
    silent_since_ns = time.time_ns() - 600 * SECOND
    recorder.put("/said", [Sample(silent_since_ns, 0, None, b"\0\1\0\0\7\0\0\0")])

    async def count(start: str, of: Memory = memory) -> int:
        return (await bags.read(robot, of, "run", "/said", Selection(message_limit=20), start)).count

    await soon(lambda: is_on_the_disk(folder))
    assert (await count(""), await count("last 30 s"), await count("11 min ago")) == (1, 0, 1)
    source = await open_bag(memory, "run", "last 30 s")
    assert abs(source.duration_s - 30.0) < 1.0
    assert (await timing.measure(source, ["/said"])).topics[0].count == 0
    await memory.close()
    later = Memory(tmp_path)
    assert await count("last 30 s", later) == 1
    await later.close()


async def test_a_named_topic_that_nobody_publishes_is_told(tmp_path: Path) -> None:
    memory = Memory(tmp_path)
    state = await recording.start(robot_of(MadeBridge()), memory, Wanted(topics=["/later"]))
    assert state.notes == ["/later: nobody has published it so far; it joins within a second after somebody does."]
    await memory.close()


async def test_what_is_still_being_recorded_is_not_called_damaged(tmp_path: Path) -> None:
    memory = Memory(tmp_path)
    await recording.start(robot_of(MadeBridge()), memory, Wanted(name="run"))
    assert (await bags.info(memory, "run")).problems == ["It is still being recorded."]
    await memory.close()
    assert (await bags.info(Memory(tmp_path), "run")).problems == []
