"""Programs of the how-to that also work on recordings: asked of made ones, without ROS."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("pydantic_monty", reason="needs the extra `programs`")

from ros2_mcp.compose.server import SOURCE_KINDS, assemble
from ros2_mcp.guard.guard import Guard
from ros2_mcp.guard.policy import Policy
from ros2_mcp.mcp.binding import CallFailed
from ros2_mcp.mcp.toolset import Toolset
from ros2_mcp.ops.memory.bag_store import BagStore
from ros2_mcp.ops.results.results import silent
from ros2_mcp.programs.kept import KeptPrograms
from ros2_mcp.settings import Settings
from support.made_bridge import MadeBridge, robot_of
from support.room_bag import LENGTH_S, ODOM_IN_MAP, RATE_HZ, Pose2, pose_at, room_bag
from support.source import ROOT

PROGRAMS = ROOT / "docs" / "how-to" / "programs"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    bags = tmp_path_factory.mktemp("bags")
    room_bag(bags / "monday")
    room_bag(bags / "tuesday")
    return bags


@pytest.fixture
async def tools(folder: Path) -> AsyncGenerator[Toolset, None]:
    store = BagStore(folder)
    robot = robot_of(MadeBridge(), KeptPrograms(PROGRAMS))
    yield Toolset(robot, store, ["all"], SOURCE_KINDS)
    await robot.jobs.close()
    await store.close()


async def run(tools: Toolset, name: str, **inputs: Any) -> dict[str, Any]:
    result = await tools.call("ros2_program_run", {"program": name, "inputs": inputs}, silent)
    value = result.structured_content or {}
    assert value["outcome"] == "ended", value
    return value


async def test_two_recordings_are_compared_number_by_number(tools: Toolset) -> None:
    x = "pose.pose.position.x"
    ran = await run(tools, "compare-recordings", before="monday", after="tuesday", fields=[x])
    count = round(LENGTH_S * RATE_HZ)
    halfway = pose_at((count - 1) / 2 / RATE_HZ)  # it drives at one speed
    mean = f"{Pose2(*ODOM_IN_MAP).inverse().then(halfway).x:.4g}"
    [line] = ran["printed"]
    assert line.startswith(f"{x}: {count} and {count} messages, mean {mean} and {mean}"), line


async def test_free_directions_are_mapped_from_a_recording(tools: Toolset) -> None:
    ran = await run(tools, "free-directions", bag="monday", sectors=4, free_m=0.1)
    assert ran["returned"]["value"] == [0, 90, 180, 270]


async def test_what_drifts_is_found_in_a_recording(tools: Toolset) -> None:
    ran = await run(tools, "find-drifting", topics=["/odom"], bag="monday")
    assert any(line.startswith("/odom.pose.pose.position.x: +") for line in ran["printed"]), ran


async def test_on_a_recording_programs_that_read_run_and_others_do_not(folder: Path) -> None:
    made = assemble(Settings(bag=folder / "monday", programs=PROGRAMS))
    try:
        await run(made.toolset, "free-directions")
        with pytest.raises(CallFailed, match="no member `publish`"):
            await run(made.toolset, "drive-until")
    finally:
        await made.robot.jobs.close()
        await made.store.close()


async def test_who_only_reads_runs_programs_that_read_and_no_others(folder: Path) -> None:
    store, robot = BagStore(folder), robot_of(MadeBridge(), KeptPrograms(PROGRAMS))
    robot.guard = Guard(Policy(read_only=True))
    tools = Toolset(robot, store, ["all"], SOURCE_KINDS)
    try:
        await run(tools, "free-directions", bag="monday")
        with pytest.raises(CallFailed, match="no member `publish`"):
            await run(tools, "drive-until")
    finally:
        await robot.jobs.close()
        await store.close()
