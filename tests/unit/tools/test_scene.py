"""The scene of a recording: what is in the picture lies where it was, at any moment, in any frame."""

from __future__ import annotations

import asyncio
import base64
import io
import math
import os
from collections.abc import AsyncGenerator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image, ImageColor

from ros2_mcp.compose.server import SOURCE_KINDS
from ros2_mcp.mcp.binding import CallFailed
from ros2_mcp.mcp.toolset import Toolset
from ros2_mcp.model.text import quoted
from ros2_mcp.ops.memory.bag_store import BagStore
from ros2_mcp.ops.navigation.known_places import NamedPlace, places_of
from ros2_mcp.pictures.scene import GOAL, PATH, PLACE, ROBOT, SCAN
from support.made_bridge import MadeBridge, robot_of
from support.room_bag import GOAL as GOAL_AT
from support.room_bag import HALF_LENGTH_M, HALF_WIDTH_M, ODOM_IN_MAP, Pose2, pose_at, room_bag

LETHAL, INSCRIBED = (255, 0, 255), (0, 255, 255)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    bags = tmp_path_factory.mktemp("bags")
    room_bag(bags / "room", costs=True)
    room_bag(bags / "lost", without=frozenset({"/tf", "/tf_static"}))
    room_bag(bags / "mapless", without=frozenset({"/map"}))
    return bags


@pytest.fixture
async def tools(folder: Path) -> AsyncGenerator[Toolset, None]:
    store = BagStore(folder)
    yield Toolset(robot_of(MadeBridge()), store, ["all"], SOURCE_KINDS)
    await store.close()


class Seen:
    """A scene with its picture: pixels by places, and places of colours."""

    def __init__(self, facts: dict[str, Any], pixels: np.ndarray, summary: str) -> None:
        self.facts, self.pixels, self.summary = facts, pixels, summary

    def pixel(self, x: float, y: float) -> tuple[int, int]:
        facts = self.facts
        metres = facts["metres_per_pixel"]
        row = facts["top_px"] + (facts["y_max_m"] - y) / metres
        return int(row), int(facts["left_px"] + (x - facts["x_min_m"]) / metres)

    def colour(self, x: float, y: float) -> tuple[int, ...]:
        return tuple(int(part) for part in self.pixels[self.pixel(x, y)])

    def places(self, colour: str | tuple[int, ...]) -> np.ndarray:
        """x and y of every pixel of the ground with about that colour."""
        facts = self.facts
        wanted = np.array(ImageColor.getrgb(colour) if isinstance(colour, str) else colour)
        top, left = facts["top_px"], facts["left_px"]
        low, right = self.pixel(facts["x_max_m"], facts["y_min_m"])
        ground = self.pixels[top:low, left:right].astype(int)
        rows, columns = np.nonzero(np.abs(ground - wanted).max(axis=2) < 40)
        metres = facts["metres_per_pixel"]
        return np.stack((facts["x_min_m"] + columns * metres, facts["y_max_m"] - rows * metres), axis=1)

    def layer(self, kind: str) -> dict[str, Any]:
        [found] = [layer for layer in self.facts["layers"] if layer["kind"] == kind]
        return found


async def look(tools: Toolset, **arguments: Any) -> Seen:
    result = await tools.call("ros2_scene", arguments, lambda *_: asyncio.sleep(0))
    [picture] = [part for part in result.content if part.type == "image"]
    data = base64.b64decode(picture.data)
    if folder := os.environ.get("ROS2_MCP_PICTURES"):  # to look at
        Path(folder, f"scene_{'_'.join(map(str, arguments.values()))}.png".replace("/", "-")).write_bytes(data)
    image = Image.open(io.BytesIO(data)).convert("RGB")
    assert max(image.size) <= 1568 and len(data) <= 700_000
    text: str = result.content[0].text  # type: ignore[union-attr]
    return Seen(result.structured_content or {}, np.asarray(image), text.partition("\n{")[0])


def near(points: np.ndarray, x: float, y: float, within: float) -> int:
    return int((np.hypot(points[:, 0] - x, points[:, 1] - y) <= within).sum())


@pytest.mark.promise("ros2_scene", "Draw the scene from above with lines labelled in metres: map or costmap")
async def test_walls_and_free_floor_lie_where_the_map_has_them(tools: Toolset) -> None:
    seen = await look(tools, bag="room")
    assert seen.facts["frame_id"] == "map"
    assert max(seen.colour(4.33, -0.93)) < 60  # in the blue box
    assert min(seen.colour(3.3, -2.3)) > 240  # on free floor
    assert seen.layer("grid")["name"] == "/map"


@pytest.mark.promise("ros2_scene", "robot and heading")
async def test_the_robot_is_where_it_was_with_its_footprint_and_heading(tools: Toolset) -> None:
    seen = await look(tools, bag="room", time="3 s in")
    pose = pose_at(3.0)
    assert (seen.facts["robot_x_m"], seen.facts["robot_y_m"]) == pytest.approx((pose.x, pose.y), abs=0.04)
    assert seen.facts["robot_yaw_deg"] == pytest.approx(math.degrees(pose.yaw), abs=0.2)
    body = seen.places(ROBOT)
    for x, y in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        corner = pose.then(Pose2(x * HALF_LENGTH_M, y * HALF_WIDTH_M, 0))
        assert near(body, corner.x, corner.y, 0.06), "a corner of the footprint"
    assert near(body, pose.x, pose.y, 2.0) == len(body)


async def test_any_moment_is_shown(tools: Toolset) -> None:
    early, late = [await look(tools, bag="room", time=f"{seconds} s in") for seconds in (1, 5)]
    assert early.facts["seconds_from_start"] == pytest.approx(1, abs=0.01)
    assert late.facts["robot_x_m"] - early.facts["robot_x_m"] == pytest.approx(pose_at(4).x, abs=0.05)


@pytest.mark.promise("ros2_scene", "scans")
async def test_scan_points_lie_on_the_walls_they_saw(tools: Toolset) -> None:
    seen = await look(tools, bag="room")
    points = seen.places(SCAN)
    walls = (
        np.abs(points[:, 0] + 2.0),
        np.abs(points[:, 1] - 3.0),
        np.abs(points[:, 1] + 3.0),
        np.abs(points[:, 0] - 2.45),
    )
    on_wall = np.min(walls, axis=0) < 0.06
    assert len(points) > 1000 and on_wall.mean() > 0.6  # the others are on the obstacles
    assert near(points, 0.0, 0.0, 0.8) == 0


@pytest.mark.promise("ros2_scene", "paths, goals")
async def test_path_and_goal_are_shown_and_told(tools: Toolset) -> None:
    seen = await look(tools, bag="room")
    goal = seen.layer("goal")
    assert (goal["x_m"], goal["y_m"]) == pytest.approx(GOAL_AT, abs=1e-3)
    assert goal["yaw_deg"] == pytest.approx(math.degrees(pose_at(0).yaw), abs=0.1)
    assert near(seen.places(GOAL), *GOAL_AT, 0.06) > 20
    assert near(seen.places(PATH), GOAL_AT[0] / 4, GOAL_AT[1] / 4, 0.05) > 5
    assert "path /plan to (2.00, 1.30)" in seen.summary


async def test_before_there_was_a_goal_none_is_shown(tools: Toolset) -> None:
    seen = await look(tools, bag="room", time="0.5 s in")
    assert not {"goal", "path"} & {layer["kind"] for layer in seen.facts["layers"]}


async def test_a_costmap_has_the_colours_of_costmaps(tools: Toolset) -> None:
    seen = await look(tools, bag="room", grid="costmap")
    assert seen.layer("costmap")["name"] == "/global_costmap/costmap"
    lethal, inscribed = seen.places(LETHAL), seen.places(INSCRIBED)
    assert near(lethal, 4.33, -0.93, 0.2) > 200  # the blue box
    assert near(inscribed, 4.33, -0.5, 0.08) > 20 and not near(inscribed, 4.33, -0.93, 0.2)


async def test_the_robots_own_frame_shows_it_in_the_middle(tools: Toolset) -> None:
    seen = await look(tools, bag="room", frame="base_link", radius_m=2.0)
    facts = seen.facts
    assert (facts["robot_x_m"], facts["robot_y_m"], facts["robot_yaw_deg"]) == pytest.approx((0, 0, 0), abs=1e-3)
    assert [facts[key] for key in ("x_min_m", "x_max_m", "y_min_m", "y_max_m")] == pytest.approx([-2, 2, -2, 2])
    assert facts["meaning"]["scan"]["is_base"]
    pillar = pose_at(5.9).inverse().then(Pose2(1.67, -0.93, 0))  # of the map
    assert max(seen.colour(pillar.x, pillar.y)) < 60
    seen_side = pose_at(5.8).inverse().then(Pose2(1.6, -0.78, 0))  # by the scan
    assert near(seen.places(SCAN), seen_side.x, seen_side.y, 0.1) > 20


async def test_a_turned_frame_turns_the_map(tools: Toolset) -> None:
    seen = await look(tools, bag="room", frame="odom")
    box = Pose2(*ODOM_IN_MAP).inverse().then(Pose2(4.33, -0.93, 0))
    assert max(seen.colour(box.x, box.y)) < 60
    free = Pose2(*ODOM_IN_MAP).inverse().then(Pose2(3.3, -2.3, 0))
    assert min(seen.colour(free.x, free.y)) > 200


@pytest.mark.promise("ros2_scene", "named places")
async def test_named_places_are_shown_where_they_are(folder: Path) -> None:
    store, robot = BagStore(folder), robot_of(MadeBridge())
    places_of(robot).set(NamedPlace("the door", "map", 2.5, 1.3))
    places_of(robot).set(NamedPlace("drifted", "odom", 0.5, 0.5))
    places_of(robot).set(NamedPlace("another building", "map", 900.0, 900.0))
    seen = await look(Toolset(robot, store, ["all"], SOURCE_KINDS), bag="room")
    await store.close()
    places = {layer["name"]: (layer["x_m"], layer["y_m"]) for layer in seen.facts["layers"] if layer["kind"] == "place"}
    drifted = Pose2(*ODOM_IN_MAP).then(Pose2(0.5, 0.5, 0))
    assert places["the door"] == (2.5, 1.3) and places["drifted"] == pytest.approx((drifted.x, drifted.y), abs=1e-3)
    assert near(seen.places(PLACE), 2.5, 1.3, 0.06) > 20
    assert seen.facts["x_max_m"] < 10
    assert f"place {quoted('the door')} (2.50, 1.30)" in seen.summary


async def test_without_transforms_the_map_is_shown_and_it_says_what_is_missing(tools: Toolset) -> None:
    seen = await look(tools, bag="lost")
    assert {layer["kind"] for layer in seen.facts["layers"]} == {"grid", "goal", "path"}
    missing = " ".join(seen.facts["missing"])
    assert "The scan /scan is not shown: no transforms connect its frame laser with map." in missing
    assert "The robot is not shown: nothing reports its place in map." in missing


async def test_without_a_map_the_scan_shows_the_room(tools: Toolset) -> None:
    seen = await look(tools, bag="mapless")
    assert seen.facts["frame_id"] == "map" and len(seen.places(SCAN)) > 1000


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"frame": "mapp"}, r"There is no frame mapp\..*Did you mean map\?"),
        ({"grid": "/nowhere"}, "/nowhere"),
        ({"grid": "/scan"}, "/scan is a sensor_msgs/msg/LaserScan"),
        ({"bag": "lost", "radius_m": 2}, "The robot's pose in map is unknown"),
        ({"bag": "mapless", "grid": "costmap"}, "No costmap has a publisher"),
    ],
)
async def test_what_cannot_be_shown_is_refused_with_the_reason(
    tools: Toolset, arguments: dict[str, Any], said: str
) -> None:
    with pytest.raises(CallFailed, match=f"(?s){said}"):
        await tools.call("ros2_scene", {"bag": "room", **arguments}, lambda *_: asyncio.sleep(0))
