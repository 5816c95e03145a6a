"""Relays that lead in a circle are found, whatever their length; a relay is a job, and its last counts are kept."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

import pytest

from ros2_mcp.model.errors import BadInput, BridgeLost
from ros2_mcp.ops import relay
from ros2_mcp.ops.relay import Relay, RelayRequest, way
from ros2_mcp.robot import Robot
from support.made_bridge import NUMBER, MadeBridge, robot_of
from support.tasks import soon


@pytest.fixture
def bridge() -> MadeBridge:
    return MadeBridge()


@pytest.fixture
async def robot(bridge: MadeBridge) -> AsyncIterator[Robot]:
    robot = robot_of(bridge)
    yield robot
    await robot.jobs.close()
    assert not bridge.relays


def from_to(source: str, destination: str) -> RelayRequest:
    return RelayRequest(source_topic=source, destination_topic=destination, message_type=NUMBER, duration_s=0.0)


def test_a_way_along_several_relays_is_found() -> None:
    relays = [("/a", "/b"), ("/b", "/x"), ("/b", "/c"), ("/c", "/d")]
    assert way(relays, "/a", "/d") == ["/a", "/b", "/c", "/d"]
    assert way(relays, "/d", "/a") == []


def test_a_circle_of_others_ends_the_search() -> None:
    assert way([("/a", "/b"), ("/b", "/a")], "/a", "/z") == []


async def test_no_relay_may_feed_itself_through_others_unless_they_have_ended(robot: Robot) -> None:
    one = await relay.start(robot, from_to("/a", "/b"))
    await relay.start(robot, from_to("/b", "/c"))
    with pytest.raises(BadInput, match="relays lead from /a to /b to /c already"):
        await relay.start(robot, from_to("/c", "/a"))
    await relay.stop(robot, one.relay_id)
    assert (await relay.start(robot, from_to("/c", "/a"))).state == "running"


async def test_of_two_that_start_at_once_and_would_feed_each_other_one_is_refused(robot: Robot) -> None:
    started = await asyncio.gather(
        relay.start(robot, from_to("/a", "/b")), relay.start(robot, from_to("/b", "/a")), return_exceptions=True
    )
    assert sorted(type(outcome).__name__ for outcome in started) == ["BadInput", "RelayState"]


async def test_the_same_relay_runs_once(robot: Robot) -> None:
    first = await relay.start(robot, from_to("/a", "/b"))
    with pytest.raises(BadInput, match=f"{first.relay_id} relays /a to /b already"):
        await relay.start(robot, from_to("/a", "/b"))


async def test_a_relay_whose_bridge_is_lost_has_failed_and_says_so(bridge: MadeBridge, robot: Robot) -> None:
    await relay.start(robot, from_to("/a", "/b"))
    [running] = robot.jobs.running(Relay)
    bridge.lose_relays()
    await soon(lambda: not running.is_running)
    assert isinstance(running.failure, BridgeLost)
    [told] = (await relay.list_relays(robot)).relays
    assert (told.state, told.note) == ("failed", "The bridge was lost.")


async def test_a_relay_that_is_stopped_tells_its_last_counts(robot: Robot) -> None:
    begun = await relay.start(robot, from_to("/a", "/b"))
    stopped = await relay.stop(robot, begun.relay_id)
    assert (stopped.state, stopped.passed, stopped.stopped_with_zero) == ("stopped", 5, False)
    assert (await relay.stop(robot, begun.relay_id)) == stopped
