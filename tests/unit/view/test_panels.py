"""The panels' content, of a recording."""

from __future__ import annotations

import base64
import struct
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from ros2_mcp.compose.robot import robot_for, store_for
from ros2_mcp.model.errors import NotFound
from ros2_mcp.ops.sources.kinds import Sources
from ros2_mcp.settings import Settings
from ros2_mcp.view import panels
from ros2_mcp.view.look import Chunks, Look
from ros2_mcp.view.panels.frames import FramesPanel
from ros2_mcp.view.panels.map import MapPanel
from ros2_mcp.view.panels.plot import PlotPanel
from ros2_mcp.view.panels.space import SpacePanel
from ros2_mcp.view.panels.values import ValuesPanel
from ros2_mcp.view.views import panel_in_words
from support.panels import page_of
from support.room_bag import RATE_HZ, SPEED, START_NS, room_bag

SECOND = 1_000_000_000
NONE: Any = None
"""A source that nobody reads."""


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
        shown = await FramesPanel(page_of(look.source)).show(look)
    assert shown
    edges = {edge["child"]: edge for edge in shown["edges"]}
    assert (shown["roots"], edges["odom"]["parent"], edges["base_link"]["parent"]) == (["map"], "map", "odom")
    assert edges["base_link"]["rate_hz"] and edges["base_link"]["age_s"] <= 0.2
    assert shown["problems"] == [] and shown["at_s"] == (START_NS + 3 * SECOND) / 1e9


async def test_a_plot_of_a_recording_ends_at_the_time_that_is_shown_also_after_a_step_back(tmp_path: Path) -> None:
    bag, panel = room_bag(tmp_path / "room"), None
    for until_s in (2.0, 4.0, 1.0):
        async with looking(bag, until_s, "/odom") as look:
            panel = panel or PlotPanel(page_of(look.source))
            shown = await panel.show(look)
        assert shown
        width = 1 + len(shown["fields"])
        data = base64.b64decode(shown["bulk"])
        rows = list(struct.iter_unpack(f"<{width}d", data))
        assert len(rows) == pytest.approx(until_s * RATE_HZ, abs=1.1)
        assert rows == sorted(rows) and shown["at_s"] == rows[-1][0]
        assert rows[-1][0] - START_NS / 1e9 == pytest.approx(until_s, abs=0.11)
    along = [one["name"] for one in shown["fields"]].index("pose.pose.position.x")
    assert shown["fields"][along]["unit"] == "m"
    assert 0.0 < rows[-1][1 + along] - rows[0][1 + along] < SPEED  # within a second


async def test_what_has_no_numbers_is_not_plotted(tmp_path: Path) -> None:
    async with looking(room_bag(tmp_path / "room"), 2.0, "/tf") as look:
        with pytest.raises(NotFound, match="no numbers to plot"):
            await PlotPanel(page_of(look.source)).show(look)


async def test_scans_and_frames_stand_in_the_frame_of_the_map(tmp_path: Path) -> None:
    async with looking(room_bag(tmp_path / "room"), 3.0) as look:
        shown = await SpacePanel(page_of(look.source)).show(look)
    assert shown
    frames = {one["name"]: one for one in shown["frames"]}
    assert (shown["frame"], frames["odom"]["parent"], frames["map"]["pose"]) == ("map", "map", [0, 0, 0, 0, 0, 0, 1])
    assert frames["base_link"]["pose"][0] == pytest.approx(0.75, abs=0.1)
    assert [one["name"] for one in shown["scans"]] == ["/scan"] and len(shown["bulk"][0]) > 500
    assert (shown["cloud"], shown["model"], shown["missing"]) == (None, None, [])


def test_what_a_panel_shows_from_before_is_told_to_the_model_with_its_age() -> None:
    page, now_ns = page_of(NONE), 1000 * SECOND
    content = {"topic": "/armed", "at_s": 988.0, "from_before": True}
    assert panel_in_words(ValuesPanel(page), content, now_ns) == "values: /armed; 12 s old, from before"
    assert panel_in_words(ValuesPanel(page), {**content, "from_before": False}, now_ns) == "values: /armed"
    old = {"frame": "map", "old": ["goal /goal_pose 8.2 s old, from before"]}
    assert panel_in_words(MapPanel(page), old, now_ns).endswith("; goal /goal_pose 8.2 s old, from before")


def test_each_panel_is_found_by_its_module_and_is_drawn_by_a_file_of_its_name() -> None:
    drawn = {file.stem for file in (Path(__file__).parents[3] / "viewer" / "src" / "panels").glob("*.ts")}
    modules = {file.stem for file in Path(panels.__path__[0]).glob("*.py")} - {"__init__"}
    assert {kind.name for kind in panels.panel_types()} == modules
    assert modules - {"robot"} == drawn  # the robot is the head of the page


def test_a_cloud_drives_no_map_out() -> None:
    chunks = Chunks(most=2)
    chunks.keep("map", b"map")
    for number in range(5):
        chunks.keep(str(number), b"cloud", "cloud")
    assert [key for key in ("map", "2", "3", "4") if chunks.find(key)] == ["map", "3", "4"]
