"""Windows of signals made for the purpose, and a robot whose bridge is made for it."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterable, Mapping
from typing import Any

import pytest

from ros2_mcp.model.samples import Sample
from ros2_mcp.robot import Robot
from ros2_mcp.values.definitions import Definitions
from support.made_bridge import MadeBridge, robot_of
from support.made_windows import CODEC, START_NS, Make, Window, encoded


@pytest.fixture
def bridge() -> MadeBridge:
    return MadeBridge()


@pytest.fixture
async def robot(bridge: MadeBridge) -> AsyncIterator[Robot]:
    """A robot at that bridge; after the test no relay may be open."""
    robot = robot_of(bridge)
    yield robot
    await robot.jobs.close()
    assert not bridge.relays


@pytest.fixture
def definitions() -> Definitions:
    return CODEC.definitions


@pytest.fixture
def window() -> Make:
    """A window: `window("/x", "std_msgs/msg/Float64", [(0.1, {"data": 1.0}), …], duration_s=5.0)`; times in seconds."""

    def make(
        topic: str,
        type_name: str,
        messages: Iterable[tuple[float, Mapping[str, Any]]],
        duration_s: float = 5.0,
        **more: Any,
    ) -> Window:
        samples = [
            Sample(START_NS + round(at * 1e9), 0, None, encoded(type_name, value)) for at, value in messages
        ]  # fmt: skip
        end_ns = START_NS + round(duration_s * 1e9)
        return Window(
            topic=topic,
            type=type_name,
            codec=CODEC,
            samples=samples,
            start_ns=START_NS,
            end_ns=end_ns,
            **more,
        )

    return make
