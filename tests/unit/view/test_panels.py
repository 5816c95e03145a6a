"""The panels' content, of a recording."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path

from ros2_mcp.library import robot_for, store_for
from ros2_mcp.ops.sources.kinds import Sources
from ros2_mcp.ops.view.frames import FramesPanel
from ros2_mcp.ops.view.look import Look
from ros2_mcp.settings import Settings
from support.room_bag import START_NS, room_bag

SECOND = 1_000_000_000


@asynccontextmanager
async def looking(bag: Path, until_s: float, chosen: str = "") -> AsyncGenerator[Look, None]:
    """A look at a recording, `until_s` seconds after its start."""
    settings = Settings(bag=bag)
    store = store_for(settings)
    robot = robot_for(settings, store)
    source = await Sources(robot, store).open()
    yield Look(robot, source.part(START_NS, START_NS + round(until_s * SECOND)), chosen)
    await store.close()


async def test_frames_are_told_parents_first(tmp_path: Path) -> None:
    async with looking(room_bag(tmp_path / "room"), 3.0) as look:
        shown = await FramesPanel().show(look)
    assert shown
    edges = {edge["child"]: edge for edge in shown["edges"]}
    assert (shown["roots"], edges["odom"]["parent"], edges["base_link"]["parent"]) == (["map"], "map", "odom")
    assert edges["base_link"]["rate_hz"] and edges["base_link"]["age_s"] <= 0.2
    assert shown["problems"] == [] and shown["at_s"] == (START_NS + 3 * SECOND) / 1e9
