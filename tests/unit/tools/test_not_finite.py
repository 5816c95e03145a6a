"""No number of a robot that is not finite makes a tool or a panel fail, or stands as "nan" in a sentence."""

from __future__ import annotations

import json
import re
from collections.abc import AsyncGenerator
from pathlib import Path
from typing import Any

import pytest
from mcp.types import TextContent

from ros2_mcp.bags.qos import qos_text
from ros2_mcp.bags.stored import StoredTopic
from ros2_mcp.bags.writer import BagWriter
from ros2_mcp.compose.server import SOURCE_KINDS
from ros2_mcp.mcp.binding import CallFailed
from ros2_mcp.mcp.toolset import Toolset
from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.finite import finite
from ros2_mcp.model.qos import QoS
from ros2_mcp.model.samples import Sample
from ros2_mcp.ops.memory.bag_store import BagStore
from ros2_mcp.ops.results.results import silent
from ros2_mcp.ops.sources.kinds import Sources
from ros2_mcp.view.look import Look
from ros2_mcp.view.panels import panel_types
from support.made_bridge import MadeBridge, robot_of
from support.made_windows import START_NS, encoded
from support.msg_texts import text_of
from support.odd_numbers import FRAMES, MESSAGES
from support.panels import page_of

SPOKEN = re.compile(r"\b[+-]?(nan|inf)\b|fault of this server")
"""As Python writes them. A sentence says NaN and infinite; a value is "nan" in quotes, as are words of the robot."""
QUOTED = re.compile(r'"(?:\\.|[^"\\])*"|«[^»]*»')
BAGS = ("broken_frames", "good_frames")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two recordings of odd numbers: in one of them the frames are well, so that what has a place is drawn."""
    folder = tmp_path_factory.mktemp("odd")
    for bag, changed in zip(BAGS, ({}, {"/tf": FRAMES}), strict=True):
        (folder / bag).mkdir()
        writer = BagWriter(folder / bag, bag)
        for number, (topic, (kind, value)) in enumerate({**MESSAGES, **changed}.items()):
            writer.add_topic(StoredTopic(topic, kind, None, "ros2msg", text_of(kind), qos_text([QoS()])))
            for second in range(3):
                at_ns = START_NS + second * 10**9 + number
                writer.write(topic, Sample(at_ns, at_ns, second, encoded(kind, value)))
        writer.close()
    return folder


@pytest.fixture
async def tools(folder: Path) -> AsyncGenerator[Toolset, None]:
    store = BagStore(folder)
    yield Toolset(robot_of(MadeBridge()), store, ["all"], SOURCE_KINDS)
    await store.close()


async def told(tools: Toolset, name: str, **arguments: Any) -> str:
    try:
        result = await tools.call(name, arguments, silent)
    except CallFailed as error:
        return str(error)
    return "\n".join(part.text for part in result.content if isinstance(part, TextContent))


def topics_of(*kinds: str) -> list[str]:
    return [topic for topic, (kind, _) in MESSAGES.items() if not kinds or kind.rpartition("/")[2] in kinds]


def calls() -> dict[str, list[dict[str, Any]]]:
    """By tool, what it is asked of each recording."""
    each = [{"topic_name": topic} for topic in topics_of()]
    fields = ("/plan:poses", "/odom:pose.pose", "/goal_pose", "/local_costmap/published_footprint:polygon.points")
    frames = (("map", "base_link"), ("base_link", "laser"), ("base_link", "camera"), ("base_link", "arm"))
    conditions = (
        ("/speed", "data > 1"),
        ("/odom", "pose.pose.position.x > 1 or yaw(pose.pose.orientation) > 1"),
        ("/scan_step", "nearest(-30, 30) < 1"),
        ("/scan", "range_at(0) < 1"),
        ("/list", "max(data) > 3 and min(data) < 0"),
    )
    return {
        "ros2_topic_subscribe": each,
        "ros2_topic_echo_wait": each,
        "ros2_topic_stats": [{"topic_names": [topic]} for topic in topics_of()],
        "ros2_topic_statistics": [{"topic_names": [topic]} for topic in topics_of()],
        "ros2_plot": [{"series": [topic]} for topic in topics_of()],
        "ros2_topic_compare": [{"topic1_name": "/odom", "topic2_name": name} for name in ("/odom_inf", "/odom_turned")],
        "ros2_wait_until": [{"topic_name": topic, "condition": text} for topic, text in conditions],
        "ros2_get_map_as_image": [{"topic_name": topic} for topic in topics_of("OccupancyGrid")],
        "ros2_get_pointcloud_as_bev": [{"topic_name": topic} for topic in topics_of("PointCloud2")],
        "ros2_scene": [
            *({"grid": topic} for topic in topics_of("OccupancyGrid")),
            *({"frame": frame, "radius_m": 3} for frame in ("map", "base_link", "laser")),
            {},
        ],
        "ros2_robot": [{}, {"whole": True}],
        "ros2_health_check": [{}],
        "ros2_tf_tree": [{}],
        "ros2_tf_lookup": [
            *({"target": target, "source": source} for target, source in frames),
            *({"target": "base_link", "source": "arm", "field": field} for field in fields),
        ],
    }


IN_FRAMES = ("ros2_scene", "ros2_robot", "ros2_tf_lookup", "ros2_tf_tree")
"""Of what these tell, the other recording has no place."""


@pytest.mark.parametrize(
    ("name", "bag"), [(name, bag) for bag in BAGS for name in calls() if bag == BAGS[0] or name in IN_FRAMES]
)
async def test_what_is_not_finite_is_told_in_words_and_no_tool_fails(tools: Toolset, name: str, bag: str) -> None:
    found: list[str] = []
    for arguments in calls()[name]:
        said = QUOTED.sub("…", await told(tools, name, bag=bag, **arguments))
        found += [f"{arguments}: {said[max(at.start() - 90, 0) : at.end() + 60]}" for at in SPOKEN.finditer(said)][:1]
    assert found == []


@pytest.mark.parametrize("bag", BAGS)
@pytest.mark.parametrize("panel", panel_types(), ids=lambda kind: kind.name)
async def test_no_panel_of_the_page_fails_by_them(folder: Path, panel: Any, bag: str) -> None:
    store = BagStore(folder)
    robot = robot_of(MadeBridge())
    source = await Sources(robot, store, SOURCE_KINDS).open(bag)
    kinds = [kind.rpartition("/")[2] for kind in panel.shows_types]
    for topic in ("", *(topics_of(*kinds) if kinds or panel.shows_kind else ())):
        try:
            shown = await panel(page_of(source)).show(Look(robot, source, topic))
        except RobotError as error:  # which the page shows
            shown = str(error)
        assert not SPOKEN.search(QUOTED.sub("", json.dumps(finite(shown), default=str))), topic
    await store.close()


@pytest.mark.parametrize(
    ("topic", "field"),
    [
        ("/map", "info.origin.position.x is NaN"),
        ("/map_turned", "info.origin.orientation.z is NaN"),
        ("/map_nan", "info.resolution is NaN"),
        ("/map_inf", "info.resolution is infinite"),
        ("/map_negative", "-0.05 m"),
        ("/map_short", "3 cells"),
        ("/global_costmap/costmap", "info.origin.position.y is infinite"),
    ],
)
async def test_a_map_that_has_no_place_names_the_field(tools: Toolset, topic: str, field: str) -> None:
    for name, arguments in (("ros2_get_map_as_image", {"topic_name": topic}), ("ros2_scene", {"grid": topic})):
        assert field in await told(tools, name, bag="good_frames", **arguments)


@pytest.mark.parametrize("topic", ["/map", "/map_turned"])
async def test_a_map_whose_origin_is_not_finite_is_drawn_without_axes(tools: Toolset, topic: str) -> None:
    said = await told(tools, "ros2_get_map_as_image", topic_name=topic, bag="good_frames")
    assert "cells of" in said and "picture:" in said and "the robot is not shown" in said
    assert "origin_x_m" not in said and "corner is at" not in said and "Axes in metres" not in said


async def test_a_scene_shows_the_rest_and_names_what_it_cannot_show(tools: Toolset) -> None:
    said = await told(tools, "ros2_scene", bag="good_frames")
    assert "Robot at (0.00, 0.00)" in said and "path /plan" in said
    for field in (
        "info.origin.position.x is NaN",
        "poses[0].pose.position.x is NaN",
        "polygon.points[0].x is NaN",
        "orientation.z is NaN",
    ):
        assert field in said


async def test_the_robot_in_brief_says_unknown_with_the_field(tools: Toolset) -> None:
    said = await told(tools, "ros2_robot", bag="broken_frames", whole=True)
    for known in (
        "The robot's pose is unknown: in /odom, pose.pose.position.x is NaN",
        "map → odom is refused: its translation.x is NaN",
        "base_link → camera is refused: its translation.y is infinite",
        "/local_costmap/published_footprint is not a valid footprint: polygon.points[0].x is NaN",
        "/scan_step has no bearings: angle_increment is 0",
        "range unknown (range_min is NaN)",
        "/speed Float32 unknown (NaN)",
        "shoulder position unknown",
    ):
        assert known in said
    assert "%" not in said.partition("/battery_state")[2].partition("\n")[0]  # of no charge


async def test_where_one_frame_is_missing_the_point_that_is_none_is_named(tools: Toolset) -> None:
    of_polygon = {"field": "/local_costmap/published_footprint:polygon.points"}
    said = await told(tools, "ros2_tf_lookup", bag="good_frames", target="base_link", source="arm", **of_polygon)
    assert "Point32 1 of 4 cannot be transformed: x is NaN" in said
