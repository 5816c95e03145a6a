"""Relays that lead in a circle are found, whatever their length; a relay is a job, and its last counts are kept."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import pytest

from ros2_mcp.model.errors import BadInput, BridgeLost
from ros2_mcp.ops.relay import relay
from ros2_mcp.ops.relay.relay import Relay, RelayRequest, path_between
from ros2_mcp.robot import Robot
from support.made_bridge import NUMBER, MadeBridge
from support.tasks import soon


def from_to(source: str, destination: str) -> RelayRequest:
    return RelayRequest(source_topic=source, destination_topic=destination, message_type=NUMBER, duration_s=0.0)


def test_a_way_along_several_relays_is_found() -> None:
    relays = [("/a", "/b"), ("/b", "/x"), ("/b", "/c"), ("/c", "/d")]
    assert path_between(relays, "/a", "/d") == ["/a", "/b", "/c", "/d"]
    assert path_between(relays, "/d", "/a") == []


def test_a_circle_of_others_ends_the_search() -> None:
    assert path_between([("/a", "/b"), ("/b", "/a")], "/a", "/z") == []


async def test_no_relay_may_feed_itself_through_others_unless_they_have_ended(robot: Robot) -> None:
    one = await relay.start(robot, robot.session(), from_to("/a", "/b"))
    await relay.start(robot, robot.session(), from_to("/b", "/c"))
    with pytest.raises(BadInput, match="relays already lead from /a to /b to /c"):
        await relay.start(robot, robot.session(), from_to("/c", "/a"))
    await relay.stop(robot, one.relay_id)
    assert (await relay.start(robot, robot.session(), from_to("/c", "/a"))).state == "running"


async def test_of_two_that_start_at_once_and_would_feed_each_other_one_is_refused(robot: Robot) -> None:
    started = await asyncio.gather(
        relay.start(robot, robot.session(), from_to("/a", "/b")),
        relay.start(robot, robot.session(), from_to("/b", "/a")),
        return_exceptions=True,
    )
    assert sorted(type(outcome).__name__ for outcome in started) == ["BadInput", "RelayState"]


@pytest.mark.parametrize("transform", ["identity", "on_change", "filter"])
async def test_a_rate_without_a_rate_limit_is_an_error_that_names_the_right_transform(
    robot: Robot, transform: str
) -> None:
    request = replace(from_to("/a", "/b"), transform=transform, target_rate_hz=2.0)
    with pytest.raises(BadInput, match=f"target_rate_hz has no meaning with {transform}") as refused:
        await relay.start(robot, robot.session(), request)
    assert 'transform="rate_limit"' in refused.value.hint
    assert (await relay.list_relays(robot)).relays == []


@pytest.mark.parametrize(("given", "rate_hz"), [(None, 10.0), (2.0, 2.0)])
async def test_a_rate_limit_has_the_given_rate_or_the_default(
    robot: Robot, given: float | None, rate_hz: float
) -> None:
    request = replace(from_to("/a", "/b"), transform="rate_limit", target_rate_hz=given)
    assert (await relay.start(robot, robot.session(), request)).target_rate_hz == rate_hz


async def test_the_same_relay_runs_once(robot: Robot) -> None:
    first = await relay.start(robot, robot.session(), from_to("/a", "/b"))
    with pytest.raises(BadInput, match=f"{first.relay_id} relays /a to /b already"):
        await relay.start(robot, robot.session(), from_to("/a", "/b"))


@pytest.mark.promise("ros2_relay_list", "and the relays that ended last")
async def test_a_relay_whose_bridge_is_lost_has_failed_and_says_so(bridge: MadeBridge, robot: Robot) -> None:
    await relay.start(robot, robot.session(), from_to("/a", "/b"))
    [running] = robot.jobs.running(Relay)
    bridge.lose_relays()
    await soon(lambda: not running.is_running)
    assert isinstance(running.failure, BridgeLost)
    [told] = (await relay.list_relays(robot)).relays
    assert (told.state, told.note) == ("failed", "The bridge was lost.")


@pytest.mark.promise("ros2_relay_stop", "returns its final counts")
async def test_a_relay_that_is_stopped_tells_its_last_counts(robot: Robot) -> None:
    begun = await relay.start(robot, robot.session(), from_to("/a", "/b"))
    stopped = await relay.stop(robot, begun.relay_id)
    assert (stopped.state, stopped.published, stopped.stopped_with_zero) == ("stopped", 5, False)
    assert (await relay.stop(robot, begun.relay_id)) == stopped


async def test_a_relay_whose_client_has_gone_tells_the_last_counts_of_the_bridge_and_the_reason_once(
    robot: Robot,
) -> None:
    await relay.start(robot, robot.session(), from_to("/a", "/b"))
    [running] = robot.jobs.running(Relay)
    await robot.stop_owned(running.owner, "the end of its client, which ended its session")
    [told] = (await relay.list_relays(robot)).relays
    assert (told.state, told.published, told.elapsed_sec) == ("stopped", 12, 1.5)
    assert told.note == "It was ended by the end of its client, which ended its session."
