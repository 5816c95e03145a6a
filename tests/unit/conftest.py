"""A robot behind a link that only notes what is sent to it."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from typing import cast

import pytest

from ros2_mcp.link.client import Bridge
from ros2_mcp.robot import Robot
from support.noting_bridge import Noting


@pytest.fixture
def bridge() -> Noting:
    return Noting()


@pytest.fixture
async def robot(bridge: Noting) -> AsyncGenerator[Robot, None]:
    robot = Robot(cast(Bridge, bridge))
    yield robot
    await robot.jobs.close()
    robot.failsafes.close()
