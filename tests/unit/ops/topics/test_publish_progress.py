"""The progress of a repeat: nothing is said to be published before something was, and no line comes twice."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from time import monotonic
from typing import cast

import pytest

from ros2_mcp.link.client import Bridge
from ros2_mcp.model.commands import Repeat
from ros2_mcp.ops.topics.publish import _repeat
from ros2_mcp.robot import Robot
from support.noting_bridge import CHOICE, Noting, on

WHOLE_S = 3.0


@pytest.fixture
def bridge() -> Noting:
    return Noting()


@pytest.fixture
async def robot(bridge: Noting) -> AsyncIterator[Robot]:
    robot = Robot(cast(Bridge, bridge))
    yield robot
    await robot.jobs.close()
    robot.failsafes.close()


async def test_progress_counts_from_the_first_message_and_repeats_no_line(robot: Robot, bridge: Noting) -> None:
    told: list[tuple[float, str]] = []
    ticks = asyncio.Event()

    async def report(done: float, whole: float, line: str) -> None:
        assert whole == WHOLE_S
        told.append((done, line))
        ticks.set()

    bridge.may_answer.clear()
    command = Repeat(**on("/cmd_vel", value={}, choice=CHOICE, wait_match_s=0.0, rate_hz=10.0, duration_s=WHOLE_S))
    repeating = asyncio.ensure_future(_repeat(robot, robot.session(), command, report))
    await ticks.wait()  # the bridge has not said that it has begun
    ticks.clear()
    bridge.repeats_begun[bridge.arguments["repeat"]["name"]] = monotonic() - 2 * WHOLE_S
    await ticks.wait()
    bridge.may_answer.set()
    await repeating
    waits = "nothing published yet; waiting for a subscriber and for the stopper, which sends zero if the bridge dies"
    assert told == [(0.0, f"/cmd_vel: {waits}"), (WHOLE_S, "/cmd_vel: publishing for 3 of 3 s")]
