"""A recorded costmap that was sent whole once: at each time it is shown with what had changed by then."""

from __future__ import annotations

import base64
import io
from collections.abc import AsyncGenerator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from ros2_mcp.bags.qos import qos_text
from ros2_mcp.bags.schema import schema_text
from ros2_mcp.bags.stored import StoredTopic
from ros2_mcp.bags.writer import BagWriter
from ros2_mcp.compose.server import SOURCE_KINDS
from ros2_mcp.mcp.toolset import Toolset
from ros2_mcp.model.nav2 import COSTMAP, COSTMAP_UPDATE, GRID_UPDATE
from ros2_mcp.model.pictures import OCCUPANCY_GRID
from ros2_mcp.model.qos import QoS
from ros2_mcp.model.samples import Sample
from ros2_mcp.ops.memory.bag_store import BagStore
from support.made_bridge import MadeBridge, robot_of
from support.made_windows import CODEC, encoded

START_NS, SECOND_NS = 1_700_000_000_000_000_000, 1_000_000_000
GRID, SIDE, CELL_M = "/global_costmap/costmap", 10, 0.1
MAGENTA = (255, 0, 255)


def written(folder: Path, *, raw: bool, sent_before_s: int = 0) -> None:
    """A costmap at 0 s, its cells (x, x) occupied from x = 1, 2, 3 seconds on, and an older part that came late."""
    header = {"frame_id": "map"}
    origin = {"position": {"x": 0.0, "y": 0.0}, "orientation": {"w": 1.0}}
    topic, cells = f"{GRID}_raw" if raw else GRID, [0] * SIDE**2
    if raw:
        size: dict[str, Any] = {"resolution": CELL_M, "size_x": SIDE, "size_y": SIDE, "origin": origin}
        types, whole = (COSTMAP, COSTMAP_UPDATE), {"header": header, "metadata": size, "data": cells}
    else:
        size = {"resolution": CELL_M, "width": SIDE, "height": SIDE, "origin": origin}
        types, whole = (OCCUPANCY_GRID, GRID_UPDATE), {"header": header, "info": size, "data": cells}
    folder.mkdir()
    writer = BagWriter(folder, folder.name)
    latched = qos_text([QoS(durability="transient_local")])
    for name, kind in zip((topic, f"{topic}_updates"), types, strict=True):
        writer.add_topic(
            StoredTopic(name, kind, None, "ros2msg", schema_text(CODEC.definitions.interface(kind)), latched)
        )
    sent_ns = START_NS - sent_before_s * SECOND_NS
    writer.write(topic, Sample(START_NS, sent_ns, 1, encoded(types[0], whole)))
    sides = ("size_x", "size_y") if raw else ("width", "height")
    for x in (5, 1, 2, 3):
        at_ns = START_NS + (x % 5) * SECOND_NS
        value = {"header": header, "x": x, "y": x, sides[0]: 1, sides[1]: 1, "data": [254 if raw else 100]}
        told_ns = sent_ns - SECOND_NS if x == 5 else at_ns
        writer.write(f"{topic}_updates", Sample(at_ns, told_ns, x, encoded(types[1], value)))
    writer.close()


@pytest.fixture
async def tools(tmp_path: Path) -> AsyncGenerator[Toolset, None]:
    written(tmp_path / "told", raw=False)
    written(tmp_path / "raw", raw=True)
    written(tmp_path / "late", raw=False, sent_before_s=60)
    store = BagStore(tmp_path)
    yield Toolset(robot_of(MadeBridge()), store, ["all"], SOURCE_KINDS)
    await store.close()


async def look(tools: Toolset, **arguments: str) -> tuple[list[int], dict[str, Any]]:
    """For which x the cell (x, x) is shown occupied, and the answer."""

    async def silent(*_: object) -> None:
        pass

    result = await tools.call("ros2_scene", {"grid": "costmap", **arguments}, silent)
    facts: dict[str, Any] = result.structured_content or {}
    [picture] = [part for part in result.content if part.type == "image"]
    pixels = np.asarray(Image.open(io.BytesIO(base64.b64decode(picture.data))).convert("RGB"))

    def colour(x: int) -> tuple[int, ...]:
        away = (x + 0.35) * CELL_M  # no labelled line is there
        row = facts["top_px"] + (facts["y_max_m"] - away) / facts["metres_per_pixel"]
        column = facts["left_px"] + (away - facts["x_min_m"]) / facts["metres_per_pixel"]
        return tuple(int(part) for part in pixels[int(row), int(column)])

    return [x for x in range(SIDE) if colour(x) == MAGENTA], facts


@pytest.mark.parametrize("bag", ["told", "raw"])
async def test_a_costmap_is_shown_with_all_that_had_changed_by_then(tools: Toolset, bag: str) -> None:
    occupied, facts = await look(tools, bag=bag)
    assert occupied == [1, 2, 3], "and not what was older than the costmap"
    assert not [line for line in facts["missing"] if "changes" in line]
    assert (await look(tools, bag=bag, time="2.5 s in"))[0] == [1, 2]


async def test_what_changed_before_the_recording_is_not_known_and_that_is_told(tools: Toolset) -> None:
    occupied, facts = await look(tools, bag="late")
    assert occupied == [1, 2, 3]
    [said] = [line for line in facts["missing"] if "costmap" in line]
    assert "was sent whole 63.0 s ago; updates since: 3, the last 0.0 s ago. Some later updates" in said


async def map_shown(tools: Toolset, **arguments: str) -> tuple[list[int], dict[str, Any]]:
    """For which x the cell (x, x) is black in the picture of the map, and the answer."""

    async def silent(*_: object) -> None:
        pass

    result = await tools.call("ros2_get_map_as_image", {"topic_name": GRID, "bag": "told", **arguments}, silent)
    facts: dict[str, Any] = result.structured_content or {}
    [picture] = [part for part in result.content if part.type == "image"]
    pixels = np.asarray(Image.open(io.BytesIO(base64.b64decode(picture.data))).convert("L"))
    cell_px = CELL_M / facts["metres_per_pixel"]

    def is_black(x: int) -> bool:
        row = facts["top_px"] + (SIDE - x - 0.5) * cell_px
        return bool(pixels[int(row), int(facts["left_px"] + (x + 0.5) * cell_px)] < 64)

    return [x for x in range(SIDE) if is_black(x)], facts


async def test_the_picture_of_a_map_shows_what_has_changed_in_it_or_says_that_it_does_not(tools: Toolset) -> None:
    cells, facts = await map_shown(tools)
    assert (cells, round(facts["occupied"], 4)) == ([1, 2, 3], 0.03)
    assert "was sent whole 3.0 s ago; updates since: 3, the last 0.0 s ago." in facts["note"]
    cells, facts = await map_shown(tools, end="2 s in")
    assert cells == [1, 2]
    cells, facts = await map_shown(tools, start="2 s in")
    assert cells == []
    assert "Later updates are not shown." in facts["note"]
