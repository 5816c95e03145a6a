"""Every tool that reads messages says what a laser scan means, seen from the robot's base; here of a recording."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncGenerator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ros2_mcp.compose.server import SOURCE_KINDS
from ros2_mcp.mcp.toolset import Toolset
from ros2_mcp.ops.memory.bag_store import BagStore
from ros2_mcp.ops.results.results import AnswerBytes
from ros2_mcp.ops.sources.recorded_robot import recorded_robot
from ros2_mcp_demo.world import World
from support.made_bridge import MadeBridge, robot_of
from support.room_bag import LASER_FORWARD_M, Pose2, pose_at, room_bag

READERS: dict[str, dict[str, Any]] = {
    "ros2_topic_subscribe": {"topic_name": "/scan", "bag": "room"},
    "ros2_subscribe_multiple_topics": {"topics": [{"name": "/scan"}, {"name": "/odom"}], "bag": "room"},
    "ros2_topic_echo_wait": {"topic_name": "/scan", "bag": "room"},
    "ros2_bag_read": {"topic_name": "/scan", "bag": "room"},
}
"""Every tool that shows messages as they are; `ros2_get_messages` has a test of its own."""
LAST_S = 5.8
"""The time of the last scan."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    bags = tmp_path_factory.mktemp("bags")
    room_bag(bags / "room")
    room_bag(bags / "unmounted", without=frozenset({"/tf_static", "/tf"}))
    return bags


@pytest.fixture
async def tools(folder: Path) -> AsyncGenerator[Toolset, None]:
    store = BagStore(folder)
    yield Toolset(robot_of(MadeBridge()), store, ["all"], SOURCE_KINDS)
    await store.close()


async def answer(tools: Toolset, name: str, **arguments: Any) -> tuple[str, dict[str, Any]]:
    result = await tools.call(name, arguments, lambda *_: asyncio.sleep(0))
    text: str = result.content[0].text  # type: ignore[union-attr]
    return text.partition("\n{")[0], result.structured_content or {}


def straight_ahead_m(seconds: float) -> float:
    """From the base to what is straight ahead of the scanner, at that time."""
    laser = pose_at(seconds).then(Pose2(LASER_FORWARD_M, 0, 0))
    return LASER_FORWARD_M + float(World().cast(laser.x, laser.y, np.array([laser.yaw]))[0])


@pytest.mark.promise("README", "laser scans with what they mean: the nearest obstacle, and how far each side is free")
@pytest.mark.parametrize("name", READERS)
async def test_every_reader_says_what_a_scan_means(tools: Toolset, name: str) -> None:
    summary, found = await answer(tools, name, **READERS[name])
    reading = found["topics"][0] if "topics" in found else found
    scan = reading["meaning"]["scan"]
    assert (scan["seen_from"], scan["is_base"]) == ("base_link", True)
    assert scan["free_m"]["front"] <= straight_ahead_m(LAST_S) + 0.01
    assert "Nearest obstacle" in summary and " by side (45° each) in metres: front " in summary


async def test_messages_of_the_past_come_with_it_too(folder: Path) -> None:
    store = BagStore(folder, subject=folder / "room")
    tools = Toolset(recorded_robot(store, [AnswerBytes(32_000)]), store, ["all"], SOURCE_KINDS)
    summary, found = await answer(tools, "ros2_get_messages", topic_name="/scan")
    await store.close()
    assert found["meaning"]["scan"]["is_base"] and "Nearest obstacle" in summary


async def test_distances_are_from_the_base_and_not_from_the_scanner(tools: Toolset) -> None:
    _, found = await answer(
        tools, "ros2_topic_subscribe", topic_name="/scan", bag="room", start="0 s in", end="0.1 s in"
    )
    scan = found["meaning"]["scan"]
    pose = pose_at(0)
    nearest = min(
        math.hypot(x - pose.x, y - pose.y)
        for x, y in ((1.6 - 0.22 * 0.85, -1.0 + 0.22 * 0.53), (-2.0, pose.y), (pose.x, 3.0))
    )
    assert scan["nearest_m"] == pytest.approx(nearest, abs=0.05)


async def test_without_transforms_the_scanners_own_frame_is_told(tools: Toolset) -> None:
    summary, found = await answer(tools, "ros2_topic_subscribe", topic_name="/scan", bag="unmounted")
    assert found["meaning"]["scan"]["seen_from"] == "laser"
    assert "its mount on the base is unknown" in summary


async def test_other_messages_have_no_meaning(tools: Toolset) -> None:
    _, found = await answer(tools, "ros2_topic_subscribe", topic_name="/odom", bag="room")
    assert "meaning" not in found


async def test_the_only_map_is_shown_without_its_name(tools: Toolset) -> None:
    summary, found = await answer(tools, "ros2_get_map_as_image", bag="room")
    assert found["topic_name"] == "/map" and "/map is the only topic of type nav_msgs/msg/OccupancyGrid." in summary
    assert (found["robot_x_m"], found["robot_y_m"]) == pytest.approx((pose_at(5.9).x, pose_at(5.9).y), abs=0.05)
