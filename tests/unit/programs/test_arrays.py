"""Clouds, maps and bytes as numbers in programs: on a recording, in the sandbox, without ROS."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("pydantic_monty", reason="needs the extra `programs`")

from ros2_mcp.compose.server import SOURCE_KINDS
from ros2_mcp.mcp.toolset import Toolset
from ros2_mcp.ops.memory.bag_store import BagStore
from ros2_mcp.ops.results.results import silent
from ros2_mcp.programs.held import MOST_BYTES, Held
from support.arrays_bag import LARGE_POINTS, LARGE_SIDE, arrays_bag, small_cells
from support.made_bridge import MadeBridge, robot_of


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return arrays_bag(tmp_path_factory.mktemp("bags") / "made").parent


@pytest.fixture
async def tools(folder: Path) -> AsyncGenerator[Toolset, None]:
    store = BagStore(folder)
    robot = robot_of(MadeBridge())
    yield Toolset(robot, store, ["all"], SOURCE_KINDS)
    await robot.jobs.close()
    await store.close()


async def ran(tools: Toolset, text: str) -> dict[str, Any]:
    lines = f"import robot\ndef read(topic):\n    return robot.latest(topic, bag='made')\n{text}"
    result = await tools.call("ros2_program_run", {"program": lines}, silent)
    return result.structured_content or {}


async def value(tools: Toolset, text: str) -> Any:
    """What the last line of a program gives."""
    found = await ran(tools, text)
    assert found["outcome"] == "ended", found
    return found["returned"]["value"]


async def error(tools: Toolset, text: str) -> str:
    found = await ran(tools, text)
    assert found["outcome"] == "failed", found
    return found["error"]["message"]


# ── clouds ───────────────────────────────────────────────────────────────────────────────────────────────────────────


async def test_points_are_tuples_without_those_that_have_no_place(tools: Toolset) -> None:
    found = await value(tools, "p = robot.points(read('/points'))\n[len(p), p[0], p[3], type(p[0]) == tuple]")
    assert found == [18, [0.0, 1.0, 0.5], [0.5, 1.0, 0.5], True]  # 3 and 4 are not finite


async def test_points_have_the_fields_that_are_named(tools: Toolset) -> None:
    found = await value(tools, "robot.points(read('/points'), fields=['ring', 'intensity'])[-1]")
    assert found == [1.9, 1.0, 0.5, 3, 19.0]


async def test_of_many_points_every_nth_is_given_and_a_note_says_so(tools: Toolset) -> None:
    found = await ran(tools, "p = robot.points(read('/large_points'))\n[len(p), p[1][0]]")
    assert found["returned"]["value"] == [20_000, 1.0]
    assert "every 10th" in found["note"] and str(LARGE_POINTS) in found["note"]


async def test_stride_and_limit_choose_the_points(tools: Toolset) -> None:
    found = await value(tools, "[p[0] for p in robot.points(read('/points'), stride=5, limit=3)]")
    assert found == [0.0, 0.7, 1.2]


async def test_points_can_be_given_back_to_functions(tools: Toolset) -> None:
    text = "p = robot.points(read('/large_points'), limit=50000)\nrobot.max([one[0] for one in p])"
    assert await value(tools, text) == pytest.approx(19_999.6)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("robot.points(read('/map'))", "PointCloud2"),
        ("robot.points(read('/points'), fields=['colour'])", "colour"),
        ("robot.points(read('/points'), limit=60000)", "50000"),
        ("robot.points(read('/points'), stride=0)", "stride"),
        ("robot.points(read('/points'), fields=read('/points')['width'])", "fields is a list"),
        ("m = read('/points')\nm['data'] = m['data'][:30]\nrobot.points(m)", "30 bytes"),
        ("m = read('/points')\nm['point_step'] = 10 ** 30\nrobot.points(m)", "robot.points"),
        ("m = read('/points')\nm['width'] = -1\nrobot.points(m)", "robot.points"),
        ("m = read('/points')\nm['fields'][0]['offset'] = -8\nrobot.points(m)", "robot.points"),
        ("m = read('/points')\nm['fields'] = 7\nrobot.points(m)", "robot.points"),
    ],
)
async def test_what_is_no_cloud_is_told_with_what_is_wrong(tools: Toolset, text: str, words: str) -> None:
    assert words in await error(tools, text)


# ── grids ────────────────────────────────────────────────────────────────────────────────────────────────────────────


async def test_a_grid_says_where_it_is_and_what_is_in_it(tools: Toolset) -> None:
    found = await value(tools, "robot.grid(read('/map'))")
    shares = {"free": 0.855, "occupied": 0.05, "unknown": 0.095}
    assert {name: found[name] for name in shares} == shares
    assert (found["frame_id"], found["width"], found["height"], found["resolution_m"]) == ("map", 20, 10, 0.1)
    assert (found["origin_x_m"], found["origin_y_m"], found["origin_yaw_rad"]) == (-1.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("topic", "x", "y", "expected"),
    [
        ("/map", -0.95, 0.55, 0),
        ("/map", -0.95, 0.05, -1),
        ("/map", 0.55, 0.55, 100),
        ("/map", 1.05, 0.55, None),
        ("/map", -1.05, 0.55, None),
        ("/turned_map", 0.45, 3.55, 100),  # its x axis points along y: column 15 is 1.55 m along it
        ("/turned_map", 0.95, 2.55, -1),
    ],
)
async def test_a_value_is_found_by_its_place(
    tools: Toolset, topic: str, x: float, y: float, expected: int | None
) -> None:
    assert await value(tools, f"g = robot.grid(read({topic!r}))\n[robot.grid_value(g, {x}, {y})]") == [expected]


async def test_a_message_is_taken_in_the_place_of_its_grid(tools: Toolset) -> None:
    assert await value(tools, "robot.grid_value(read('/map'), 0.55, 0.55)") == 100


async def test_the_nearest_cell_of_a_kind_is_the_nearest_of_all(tools: Toolset) -> None:
    cells, random = small_cells(), np.random.default_rng(31)
    rows, columns = np.mgrid[0:10, 0:20]
    middles_x, middles_y = -1.0 + (columns + 0.5) * 0.1, (rows + 0.5) * 0.1
    for kind, mask in (("occupied", cells >= 50), ("free", (cells >= 0) & (cells < 50)), ("unknown", cells < 0)):
        places = np.round(random.uniform([-2, -1], [2, 2], (20, 2)), 3).tolist()
        text = f"g = robot.grid(read('/map'))\n[robot.grid_nearest(g, x, y, kind={kind!r}) for x, y in {places}]"
        for (x, y), found in zip(places, await value(tools, text), strict=True):
            away = np.hypot(middles_x - x, middles_y - y)[mask].min()
            # Distances are compared in whole cells, so that a place within a cell may choose a neighbour.
            assert found["distance_m"] == pytest.approx(away, abs=0.15)
            assert found["distance_m"] == pytest.approx(np.hypot(found["x"] - x, found["y"] - y), abs=1e-3)


async def test_no_cell_of_a_kind_is_none(tools: Toolset) -> None:
    assert await value(tools, "[robot.grid_nearest(read('/large_map'), 1, 1, kind='unknown')]") == [None]


async def test_rows_begin_at_the_origin(tools: Toolset) -> None:
    found = await value(tools, "robot.grid_rows(read('/map'))")
    assert found == small_cells().tolist()


async def test_rows_of_a_large_grid_keep_what_is_occupied_and_a_note_says_so(tools: Toolset) -> None:
    text = (
        "rows = robot.grid_rows(robot.grid(read('/large_map')))\n[len(rows), len(rows[0]), rows[333][66], rows[0][0]]"
    )
    found = await ran(tools, text)
    assert found["returned"]["value"] == [400, 400, 100, 0]
    assert "3 × 3" in found["note"] and f"{LARGE_SIDE} × {LARGE_SIDE}" in found["note"]


async def test_a_large_map_is_looked_into_where_it_stays(tools: Toolset) -> None:
    text = "m = read('/large_map')\ng = robot.grid(m)\n[m['data']['length'], robot.grid_nearest(g, 9.0, 50.0)]"
    length, nearest = await value(tools, text)
    assert length == LARGE_SIDE**2
    assert (nearest["x"], nearest["y"], nearest["value"]) == (10.025, 50.025, 100)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("robot.grid(read('/points'))", "OccupancyGrid"),
        ("m = read('/map')\nm['data'] = m['data'][:5]\nrobot.grid(m)", "5 cells"),
        ("m = read('/map')\nm['data'] = [1000] * 200\nrobot.grid(m)", "robot.grid"),
        ("m = read('/map')\nm['info']['resolution'] = 0\nrobot.grid(m)", "0"),
        ("m = read('/map')\nm['info']['width'] = 'x'\nrobot.grid(m)", "robot.grid"),
        ("robot.grid_value({'held': 99}, 0, 0)", "no longer held"),
        ("robot.grid_value(read('/map'), float('nan'), 0)", "robot.grid_value"),
        ("robot.grid_value(read('/map'), read('/map')['header'], 0)", "robot.grid_value"),
        ("robot.grid_nearest(read('/map'), 0, 0, kind=read('/map')['header'])", "kind is one of"),
        ("robot.grid_rows(read('/large_map'), stride=1)", "stride"),
        ("robot.grid(robot.latest('/map', fields=['info'], bag='made'))", "without fields"),
    ],
)
async def test_what_is_no_grid_is_told_with_what_is_wrong(tools: Toolset, text: str, words: str) -> None:
    assert words in await error(tools, text)


# ── bytes ────────────────────────────────────────────────────────────────────────────────────────────────────────────


async def test_bytes_are_read_by_the_formats_of_struct(tools: Toolset) -> None:
    text = "d = read('/depth')['data']\n[robot.unpack('<H', d, offset=10), robot.unpack('<2H', d, count=3, step=8)]"
    assert await value(tools, text) == [[5000], [[0, 1000], [4000, 5000], [8000, 9000]]]


async def test_a_large_picture_is_read_where_it_stays(tools: Toolset) -> None:
    text = "m = read('/large_image')\nrobot.unpack('3B', m['data'], offset=500 * m['step'] + 3 * 700)"
    assert await value(tools, text) == [10, 20, 30]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("robot.unpack('<Q', b'1234')", "4 bytes, and 8 are needed"),
        ("robot.unpack('<H', b'1234', count=2, step=3)", "5 are needed"),
        ("robot.unpack('<W', b'1234')", "not a format"),
        ("robot.unpack('0s', b'1234')", "1 to 100000 values"),
        ("robot.unpack('200000B', b'1234')", "1 to 100000 values"),
        ("robot.unpack('<H', b'1234', offset=-2)", "offset"),
        ("robot.unpack('<H', [1, 300])", "0 to 255"),
        ("robot.unpack('<H', 'text')", "is bytes"),
    ],
)
async def test_what_cannot_be_unpacked_is_told_with_what_is_wrong(tools: Toolset, text: str, words: str) -> None:
    assert words in await error(tools, text)


def test_what_is_held_makes_room_for_what_comes() -> None:
    held = Held()
    first = held.reference(np.zeros(MOST_BYTES // 2, np.uint8), "uint8[]")
    second = held.reference(np.zeros(MOST_BYTES // 2, np.uint8), "uint8[]")
    assert len(held.get(first)) == len(held.get(second)) == MOST_BYTES // 2
    third = held.reference(np.zeros(2 * MOST_BYTES, np.uint8), "uint8[]")
    assert len(held.get(third)) == 2 * MOST_BYTES
    with pytest.raises(Exception, match="no longer held"):
        held.get(second)


# ── help, and None ───────────────────────────────────────────────────────────────────────────────────────────────────


async def test_help_prints_all_functions_or_one_with_its_arguments_and_result(tools: Toolset) -> None:
    found = await ran(tools, "help()\nhelp(robot.drive)\nhelp('tf')")
    text = "\n".join(found["printed"])
    for each in tools.functions():
        assert f"\n{each.name}(" in text
    assert "robot.drive(distance_m: float | None = None," in text
    assert "  distance_m: Metres ahead; negative: back." in text and "  outcome: " in text
    assert "robot.tf(target: str," in text
    assert "The value of a help has" not in found.get("note", "")


async def test_none_for_what_may_be_left_out_leaves_it_out(tools: Toolset) -> None:
    text = "m = robot.latest('/map', fields=None, timeout=None, bag='made')\nm['info']['width']"
    assert await value(tools, text) == 20
    text = "robot.rates(['/map'], duration=None, start=None, bag='made')['topics'][0]['topic_name']"
    assert await value(tools, text) == "/map"


async def test_a_variable_that_is_none_before_a_loop_is_no_reason_to_refuse(tools: Toolset) -> None:
    text = "topic = None\nfor one in ['/map']:\n    topic = one\nrobot.latest(topic, bag='made')['info']['width']"
    assert await value(tools, text) == 20


async def test_who_looks_for_numpy_is_told_what_there_is(tools: Toolset) -> None:
    with pytest.raises(Exception, match=r"robot\.points"):
        await ran(tools, "import numpy as np\nnp.zeros(3)")
    with pytest.raises(Exception, match=r"robot\.unpack"):
        await ran(tools, "import struct\nstruct.unpack('<H', b'12')")
