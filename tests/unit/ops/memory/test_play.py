"""The life of a playback: how long a loop lasts, and that nothing goes on that nobody can stop."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path

import anyio
import pytest

from ros2_mcp.bags.qos import qos_text
from ros2_mcp.bags.stored import StoredTopic
from ros2_mcp.bags.writer import BagWriter
from ros2_mcp.model.errors import BadValue, Refused
from ros2_mcp.model.qos import QoS
from ros2_mcp.model.samples import Sample
from ros2_mcp.ops.memory import play as playing
from ros2_mcp.ops.memory.bag_store import BagStore
from ros2_mcp.ops.memory.play import Playback, PlaybackState, PlayRequest, status, stop
from ros2_mcp.robot import Robot
from support.made_bridge import NUMBER, MadeBridge
from support.tasks import soon

START_NS = 1_700_000_000_000_000_000
GOAL = PlayRequest(bag="run", topics=["/goal"])
Play = Callable[..., Awaitable[PlaybackState]]


@pytest.fixture
async def store(tmp_path: Path, bridge: MadeBridge) -> AsyncIterator[BagStore]:
    """With a bag of 0.6 s, whose /goal has one message at its beginning; after the test no relay may be open."""
    (tmp_path / "run").mkdir()
    writer = BagWriter(tmp_path / "run", "run")
    for topic, at_ms in (("/goal", 0), ("/odom", 0), ("/odom", 600)):
        writer.add_topic(StoredTopic(topic, NUMBER, None, "ros2msg", "int32 data\n"))
        writer.write(topic, Sample(START_NS + at_ms * 1_000_000, 0, None, b"\0\1\0\0\0\0\0\0"))
    writer.close()

    store = BagStore(tmp_path)
    yield store
    await store.close()


@pytest.fixture
def play(robot: Robot, store: BagStore) -> Play:
    async def play(request: PlayRequest, wait_s: float = 5.0) -> PlaybackState:
        return await playing.play(robot, robot.session(), store, request, wait_s)

    return play


def times_of(bridge: MadeBridge) -> list[float]:
    return [at for topic, at in bridge.heard if topic == "/goal"]


async def test_a_loop_lasts_as_long_as_the_bag_even_if_its_topic_has_one_message(
    bridge: MadeBridge, play: Play
) -> None:
    begun = asyncio.get_running_loop().time()
    state = await play(PlayRequest(bag="run", rate=2.0, topics=["/goal"], loop=True), 0.75)
    assert state.at.startswith("2023-11-14T22:13:20.") and 0 <= (state.seconds_from_start or 0) <= 0.6
    assert f"of run, at {state.at} ({state.seconds_from_start:g} s in)." in state.summary()
    assert state.state == "playing" and len(times_of(bridge)) >= 2
    assert all(at >= begun + loop * 0.3 for loop, at in enumerate(times_of(bridge))), "no loop is shorter"


async def test_the_loop_of_a_single_moment_lasts_a_tenth_of_a_second(bridge: MadeBridge, play: Play) -> None:
    end = "2023-11-14T22:13:20Z"
    await play(PlayRequest(bag="run", topics=["/goal"], end=end, loop=True), 0.45)
    assert 2 <= len(times_of(bridge)) <= 5


async def test_what_was_latched_before_the_part_that_is_played_is_published_first(
    tmp_path: Path, bridge: MadeBridge, play: Play
) -> None:
    (tmp_path / "latched").mkdir()
    writer = BagWriter(tmp_path / "latched", "latched")
    for topic, at_ms in (("/goal", 0), ("/odom", 0), ("/odom", 400)):
        qos = qos_text([QoS(durability="transient_local" if topic == "/goal" else "volatile")])
        writer.add_topic(StoredTopic(topic, NUMBER, None, "ros2msg", "int32 data\n", qos))
        writer.write(topic, Sample(START_NS + at_ms * 1_000_000, 0, None, b"\0\1\0\0\0\0\0\0"))
    writer.close()
    await play(PlayRequest(bag="latched", start="0.3 s in"))
    assert [topic for topic, _ in bridge.heard] == ["/goal", "/odom"]


async def test_a_play_of_nothing_ends_and_says_so(bridge: MadeBridge, play: Play) -> None:
    for loop in (False, True):
        state = await play(PlayRequest(bag="run", topics=["/goal"], start="0.3 s in", loop=loop))
        assert state.state == "ended" and not bridge.heard
        assert "Nothing was published" in state.note and "Nothing was published" in state.summary()


async def test_a_playback_says_of_how_many_messages_less_was_sent(bridge: MadeBridge, play: Play) -> None:
    bridge.limited = 7
    state = await play(PlayRequest(bag="run", rate=10.0, topics=["/odom"]))
    assert state.state == "ended" and "reduced 7 messages" in state.note


async def test_what_servers_of_actions_publish_is_left_out_and_refused_where_it_is_named(
    tmp_path: Path, bridge: MadeBridge, play: Play
) -> None:
    status_topic = "/dock/_action/status"
    (tmp_path / "hidden").mkdir()
    writer = BagWriter(tmp_path / "hidden", "hidden")
    for topic in ("/goal", status_topic):
        writer.add_topic(StoredTopic(topic, NUMBER, None, "ros2msg", "int32 data\n"))
        writer.write(topic, Sample(START_NS, 0, None, b"\0\1\0\0\0\0\0\0"))
    writer.close()
    state = await play(PlayRequest(bag="hidden"))
    assert [*state.published] == ["/goal"] and status_topic in state.note
    assert {topic for topic, _ in bridge.heard} == {"/goal"}
    named = PlayRequest(bag="hidden", topics=[status_topic])
    remapped = PlayRequest(bag="hidden", topics=["/goal"], remaps={"/goal": status_topic})
    for request in (named, remapped):
        with pytest.raises(Refused, match="published by the server of an action"):
            await play(request)
    assert {topic for topic, _ in bridge.heard} == {"/goal"}


async def test_a_playback_says_at_once_what_of_its_bag_is_lost(
    tmp_path: Path, store: BagStore, play: Play, robot: Robot
) -> None:
    (path,) = (tmp_path / "run").glob("*.mcap")
    whole = path.read_bytes()
    path.write_bytes(whole[: whole.rindex(b"\x0f\x04" + bytes(7))])  # without the record that ends the messages
    state = await play(PlayRequest(bag="run", topics=["/odom"], loop=True), 0.2)
    assert state.state == "playing"
    assert "after 2023-11-14T22:13:20.600000Z are lost" in state.note
    await stop(robot, state.playback_id)


async def test_a_play_that_is_cancelled_before_it_began_leaves_nothing(
    bridge: MadeBridge, robot: Robot, play: Play
) -> None:
    bridge.is_ready = False
    for _ in range(Playback.most_running):
        with anyio.move_on_after(0.05) as scope:  # as the MCP server cancels: again and again
            await play(GOAL)
        assert scope.cancelled_caught
        await soon(lambda: not bridge.relays)
    assert not robot.jobs.running(Playback)
    bridge.is_ready = True
    assert (await play(GOAL)).state == "ended"


async def test_whatever_keeps_a_play_from_beginning_closes_it(bridge: MadeBridge, robot: Robot, play: Play) -> None:
    bridge.trouble = ValueError("not foreseen")
    with pytest.raises(ValueError, match="not foreseen"):
        await play(GOAL)
    [state] = (await status(robot)).playbacks
    assert (state.state, state.note) == ("failed", "It did not begin.") and not bridge.relays


async def test_a_playback_can_be_stopped_while_it_is_beginning(bridge: MadeBridge, robot: Robot, play: Play) -> None:
    bridge.is_ready = False
    beginning = asyncio.ensure_future(play(GOAL))
    await soon(lambda: bool(bridge.relays))
    assert (await stop(robot, robot.jobs.running(Playback)[0].id)).state == "stopped"
    assert not bridge.relays and (await beginning).state == "stopped"


@pytest.mark.parametrize("cancelled", [True, False])
async def test_a_play_goes_on_after_its_waiting_but_not_after_a_cancel(
    bridge: MadeBridge, robot: Robot, play: Play, cancelled: bool
) -> None:
    endless = PlayRequest(bag="run", rate=6.0, topics=["/goal"], loop=True)
    with anyio.move_on_after(0.7 if cancelled else 5.0):
        await play(endless, 5.0 if cancelled else 0.15)
    [playback] = robot.jobs.all(Playback)
    if cancelled:
        await soon(lambda: not bridge.relays)
        assert playback.report().state == "stopped"
    else:
        heard = len(bridge.heard)
        await soon(lambda: len(bridge.heard) > heard + 2)
        assert playback.is_running


async def test_a_playback_whose_bridge_is_lost_has_failed_and_is_not_called_stopped(
    bridge: MadeBridge, robot: Robot, play: Play
) -> None:
    await play(PlayRequest(bag="run", rate=6.0, topics=["/goal"], loop=True), 0.0)
    [playback] = robot.jobs.all(Playback)
    bridge.lose_relays()
    await soon(lambda: not playback.is_running)
    assert (playback.report().state, playback.report().note) == ("failed", "The bridge was lost.")


async def test_a_bag_that_is_still_being_recorded_is_not_called_damaged_when_it_is_played(
    play: Play, store: BagStore, tmp_path: Path
) -> None:
    (tmp_path / "growing").mkdir()
    writer = BagWriter(tmp_path / "growing", "growing")
    writer.add_topic(StoredTopic("/goal", NUMBER, None, "ros2msg", "int32 data\n"))
    writer.write("/goal", Sample(START_NS, 0, None, b"\0\1\0\0\0\0\0\0"))
    writer.flush()
    store.writes(tmp_path / "growing", lambda: True)
    try:
        assert (await play(PlayRequest(bag="growing"))).note == ""
    finally:
        writer.close()


@pytest.mark.parametrize("times", [{"start": "3"}, {"end": "2020-01-01"}])
async def test_nothing_is_played_for_a_time_that_is_not_in_the_bag(play: Play, times: dict[str, str]) -> None:
    with pytest.raises(BadValue, match="not in the recording"):
        await play(PlayRequest(bag="run", **times))
