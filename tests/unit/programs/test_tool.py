"""The tool that runs programs: its name, and what its description says."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from pathlib import Path

import pytest

pytest.importorskip("pydantic_monty", reason="needs the extra `programs`")

from ros2_mcp.compose.server import SOURCE_KINDS
from ros2_mcp.mcp.binding import CallFailed
from ros2_mcp.mcp.toolset import Toolset
from ros2_mcp.ops.memory.bag_store import BagStore
from ros2_mcp.ops.results.results import silent
from ros2_mcp.programs.sandbox import CPU_S, MEMORY_BYTES, TURN_S
from ros2_mcp.tools.programs import MAX_RUN_S
from support.made_bridge import MadeBridge, robot_of


@pytest.fixture
async def tools(tmp_path: Path) -> AsyncGenerator[Toolset, None]:
    robot, store = robot_of(MadeBridge()), BagStore(tmp_path)
    yield Toolset(robot, store, ["all"], SOURCE_KINDS)
    await robot.jobs.close()
    await store.close()


async def test_a_call_by_the_former_name_is_taken_and_that_name_is_not_listed(tools: Toolset) -> None:
    assert "ros2_program_run" in tools.by_name and "ros2_run" not in tools.by_name
    result = await tools.call("ros2_run", {"program": "print(6 * 7)"}, silent)
    assert (result.structured_content or {})["printed"] == ["42"]


async def test_the_module_robot_needs_no_import(tools: Toolset) -> None:
    result = await tools.call("ros2_program_run", {"program": "robot.mean([1, 2, 6])"}, silent)
    assert (result.structured_content or {})["returned"] == {"value": 3}


async def test_who_starts_an_executable_by_the_former_name_is_told_what_it_takes(tools: Toolset) -> None:
    with pytest.raises(CallFailed, match=r"ros2_program_run has no argument 'package'.*program"):
        await tools.call("ros2_run", {"package": "demo_nodes_cpp", "executable": "talker"}, silent)


async def test_by_the_former_name_it_is_said_why_it_is_not_offered(tmp_path: Path) -> None:
    with pytest.raises(CallFailed, match=r"ros2_program_run is not offered: .*--tools core,programs"):
        await Toolset(robot_of(MadeBridge()), BagStore(tmp_path), ["core"], SOURCE_KINDS).call(
            "ros2_run", {"program": "1"}, silent
        )


@pytest.mark.promise(
    "ros2_program_run", "Limits: timeout_s, 5 s of computing between two calls, 60 s in all, 64 MB of values"
)
async def test_the_description_tells_the_limits_that_end_a_program(tools: Toolset) -> None:
    listed = tools.by_name["ros2_program_run"].listed
    description = " ".join((listed.description or "").split())
    limits = f"{TURN_S:g} s of computing between two calls, {CPU_S:g} s in all, {MEMORY_BYTES / 1e6:g} MB of values"
    assert limits in description
    assert f"at most {MAX_RUN_S:g}" in listed.input_schema["properties"]["timeout_s"]["description"]


async def test_the_description_names_every_function(tools: Toolset) -> None:
    description = tools.by_name["ros2_program_run"].listed.description or ""
    assert [each.name for each in tools.functions() if each.name not in description] == []
