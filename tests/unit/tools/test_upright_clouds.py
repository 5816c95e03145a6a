"""A cloud from above is in a frame whose z is up: by transforms, else by REP 103, else it says whose z is shown."""

from __future__ import annotations

import asyncio
import base64
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ros2_mcp.bags.qos import qos_text
from ros2_mcp.bags.stored import StoredTopic
from ros2_mcp.bags.writer import BagWriter
from ros2_mcp.compose.server import SOURCE_KINDS
from ros2_mcp.mcp.toolset import Toolset
from ros2_mcp.model.qos import QoS
from ros2_mcp.model.samples import Sample
from ros2_mcp.ops.memory.bag_store import BagStore
from support.made_bridge import MadeBridge, robot_of
from support.made_windows import encoded

AT_NS = 1_700_000_000_000_000_000
CLOUD, TF = "sensor_msgs/msg/PointCloud2", "tf2_msgs/msg/TFMessage"
OPTICAL = (-0.5, 0.5, -0.5, 0.5)
UPRIGHT = (0.0, 0.0, 0.0, 1.0)
STEP_M = 0.1

Edge = tuple[str, str, Sequence[float], Sequence[float]]
"""Parent, child, translation and rotation."""


def cloud(frame: str, points: Sequence[Sequence[float]]) -> dict[str, Any]:
    data = np.array(points, np.float32).tobytes()
    return {
        "header": {"stamp": {"sec": AT_NS // 10**9}, "frame_id": frame},
        "height": 1,
        "width": len(points),
        "point_step": 12,
        "row_step": len(data),
        "fields": [{"name": name, "offset": 4 * at, "datatype": 7, "count": 1} for at, name in enumerate("xyz")],
        "data": base64.b64encode(data).decode(),
    }


def transforms(edges: Sequence[Edge]) -> dict[str, Any]:
    def one(edge: Edge) -> dict[str, Any]:
        parent, child, at, turn = edge
        place = {
            "translation": dict(zip("xyz", at, strict=True)),
            "rotation": dict(zip("xyzw", turn, strict=True)),
        }
        header = {"stamp": {"sec": AT_NS // 10**9}, "frame_id": parent}
        return {"header": header, "child_frame_id": child, "transform": place}

    return {"transforms": [one(edge) for edge in edges]}


async def seen(folder: Path, frame: str, points: Sequence[Sequence[float]], *edges: Edge) -> dict[str, Any]:
    """The facts of the picture of that cloud, in a recording with these transforms."""
    path = folder / "run"
    path.mkdir()
    writer = BagWriter(path, "run")
    writer.add_topic(StoredTopic("/points", CLOUD, None, "", "", ""))
    writer.add_topic(StoredTopic("/tf_static", TF, None, "", "", qos_text([QoS(durability="transient_local")])))
    if edges:
        writer.write("/tf_static", Sample(AT_NS, AT_NS, 1, encoded(TF, transforms(edges))))
    writer.write("/points", Sample(AT_NS, AT_NS, 2, encoded(CLOUD, cloud(frame, points))))
    writer.close()
    store = BagStore(folder)
    tools = Toolset(robot_of(MadeBridge()), store, ["all"], SOURCE_KINDS)
    arguments = {"topic_name": "/points", "bag": "run", "resolution": STEP_M, "color_mode": "height"}
    result = await tools.call("ros2_get_pointcloud_as_bev", arguments, lambda *_: asyncio.sleep(0))
    await store.close()
    assert not result.is_error, result.content
    return result.structured_content or {}


def spans(found: dict[str, Any]) -> list[float]:
    return [found[key] for key in ("x_min_m", "x_max_m", "y_min_m", "y_max_m", "z_min_m", "z_max_m")]


def wall_ahead() -> list[tuple[float, float, float]]:
    """3 m before a camera, from 1 m to its left to 2 m to its right, from its height to 0.5 m above; optical."""
    return [(x / 20, -y / 20, 3.02) for x in range(-20, 41) for y in range(11)]


WALL = [3.0, 3.1, -2.0, 1.1, 0.0, 0.5]
BASE: Edge = ("odom", "base_link", (5.0, 0.0, 0.0), UPRIGHT)


async def test_a_camera_that_looks_ahead_is_seen_from_above_in_the_base(tmp_path: Path) -> None:
    camera: Edge = ("base_link", "depth_optical_frame", (0.2, 0.0, 0.4), OPTICAL)
    found = await seen(tmp_path, "depth_optical_frame", wall_ahead(), camera, BASE)
    assert found["frame_id"] == "base_link"
    moved = [one + by for one, by in zip(WALL, (0.2, 0.2, 0, 0, 0.4, 0.4), strict=True)]
    assert spans(found) == pytest.approx(moved, abs=STEP_M)
    assert (found["robot_x_m"], found["robot_y_m"]) == (0.0, 0.0)


async def test_a_scanner_on_its_back_and_one_that_leans_are_turned_upright(tmp_path: Path) -> None:
    on_its_back: Edge = ("base_link", "lidar", (0.0, 0.0, 1.0), (1.0, 0.0, 0.0, 0.0))
    found = await seen(tmp_path, "lidar", [(1, 2, 0.3), (1.5, 2.5, 0.3)], on_its_back, BASE)
    assert found["frame_id"] == "base_link"
    assert found["y_max_m"] <= -1.9 and found["z_max_m"] == pytest.approx(0.7)


async def test_a_scanner_that_stands_upright_is_seen_in_its_own_frame(tmp_path: Path) -> None:
    turned: Edge = ("base_link", "lidar", (0.0, 0.0, 1.0), (0.0, 0.0, math.sin(0.6), math.cos(0.6)))
    found = await seen(tmp_path, "lidar", [(1, 2, 0.3), (1.5, 2.5, 0.3)], turned, BASE)
    assert found["frame_id"] == "lidar"
    assert spans(found)[0] == pytest.approx(1.0, abs=STEP_M)
    assert "z" not in found["note"]


async def test_a_camera_on_a_wall_is_seen_in_the_world(tmp_path: Path) -> None:
    camera: Edge = ("map", "hall_optical_frame", (10.0, 0.0, 2.0), OPTICAL)
    found = await seen(tmp_path, "hall_optical_frame", wall_ahead(), camera)
    assert found["frame_id"] == "map"
    assert found["x_min_m"] == pytest.approx(13.0, abs=STEP_M)
    assert found["z_max_m"] - found["z_min_m"] == pytest.approx(0.5, abs=STEP_M)


async def test_without_transforms_an_optical_frame_is_turned_by_rep_103(tmp_path: Path) -> None:
    found = await seen(tmp_path, "camera_depth_optical_frame", wall_ahead())
    assert spans(found) == pytest.approx(WALL, abs=STEP_M)
    assert "REP 103" in found["note"] and found["robot_x_m"] is None


async def test_without_transforms_any_other_frame_is_named_as_the_one_whose_z_is_shown(tmp_path: Path) -> None:
    found = await seen(tmp_path, "livox", [(1, 2, 0.3), (1.5, 2.5, 0.3)])
    assert found["frame_id"] == "livox"
    assert "livox" in found["note"]
    assert spans(found)[4:] == pytest.approx([0.3, 0.3])
