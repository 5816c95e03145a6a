"""The whole tree of frames: as text, as a picture, and what is wrong with it."""

from __future__ import annotations

import io
import math
from typing import Any

import pytest
from PIL import Image

from ros2_mcp.model.errors import NotFound, NoTransform
from ros2_mcp.model.graph import TopicEndpoints
from ros2_mcp.model.qos import Endpoint, QoS
from ros2_mcp.ops.sources.source import GraphSnapshot
from ros2_mcp.ops.space.tf_tree import Tree, tf_tree
from support.made_windows import START_NS, Make, Recorded, Window

TF = "tf2_msgs/msg/TFMessage"
SECOND = 1_000_000_000


def tf(frame: str, child: str, at_s: float, yaw: float = 0.0) -> dict[str, Any]:
    sec, nanosec = divmod(START_NS + round(at_s * SECOND), SECOND)
    rotation = {"z": math.sin(yaw / 2), "w": math.cos(yaw / 2)}
    header = {"frame_id": frame, "stamp": {"sec": sec, "nanosec": nanosec}}
    return {"header": header, "child_frame_id": child, "transform": {"rotation": rotation}}


@pytest.fixture
def recorded(window: Make) -> Recorded:
    """map → odom ends after a second; odom → base_link → {laser, camera → optical} go on; a door stands alone."""
    moving = [(n / 10, {"transforms": [tf("odom", "base_link", n / 10)]}) for n in range(51)]
    moving += [(n / 10 + 0.01, {"transforms": [tf("map", "odom", n / 10)]}) for n in range(11)]
    static = [
        tf("base_link", "laser", 0),
        tf("base_link", "camera", 0),
        tf("camera", "optical", 0),
        tf("house", "door", 0),
    ]
    return Recorded(
        [
            window("/tf", TF, sorted(moving, key=lambda pair: pair[0])),
            window("/tf_static", TF, [(0.0, {"transforms": static})]),
        ]
    )


async def test_the_tree_is_told_with_the_health_of_each_edge(recorded: Recorded) -> None:
    tree = await tf_tree(recorded)
    assert (tree.frames, tree.roots) == (8, ["map", "house"])
    lines = tree.summary()
    assert lines[0] == "8 frames in 2 trees, 2 problem(s)."
    assert any("2 trees, with no transform between them; their roots are map, house." in line for line in lines)
    assert any("map → odom is stale: last told 4 s ago, after 10 Hz." in line for line in lines)
    text = "\n".join(lines)
    assert "    └ base_link (10 Hz" in text and "      └ camera (static)\n        └ optical (static)" in text
    assert [row.child for row in tree.edges][:3] == ["odom", "base_link", "camera"]


async def test_a_part_of_the_tree_can_be_asked_for(recorded: Recorded) -> None:
    part = await tf_tree(recorded, "camera", picture=False)
    assert (part.frames, part.roots, part.problems, part.images) == (2, ["camera"], [], [])
    with pytest.raises(NotFound, match=r"Did you mean camera\?"):
        await tf_tree(recorded, "camra")


async def test_the_picture_has_a_row_for_each_frame(recorded: Recorded) -> None:
    tree: Tree = await tf_tree(recorded)
    image = Image.open(io.BytesIO(tree.images[0].data))
    assert image.height >= 8 * 12 and image.width >= 200
    assert "red with a problem" in tree.images[0].note


async def test_nothing_told_is_an_error_that_says_so(window: Make) -> None:
    with pytest.raises(NoTransform, match="No transform is known at all"):
        await tf_tree(Recorded([window("/odom", "nav_msgs/msg/Odometry", [])]))


async def test_late_stamps_are_told_from_silence_and_what_was_told_once_from_both(window: Make) -> None:
    moving = [(n / 10, {"transforms": [tf("map", "odom", n / 10 - 8)]}) for n in range(51)]
    moving += [(n / 10 + 0.01, {"transforms": [tf("odom", "base_link", n / 10 + 4)]}) for n in range(51)]
    moving += [(1.0, {"transforms": [tf("base_link", "box", 1.0)]})]
    tree = await tf_tree(Recorded([window("/tf", TF, sorted(moving, key=lambda pair: pair[0]))]), picture=False)
    problems = "\n".join(tree.problems)
    assert "map → odom is told now with stamps that are 8" in problems
    assert "odom → base_link is stamped 3.99 s ahead" in problems
    assert "base_link → box was told once" in problems and "/tf_static" in problems


async def problems_of(window: Make, *told: tuple[float, dict[str, Any]]) -> str:
    messages = [(at_s, {"transforms": [one]}) for at_s, one in told]
    return "\n".join((await tf_tree(Recorded([window("/tf", TF, messages)]), picture=False)).problems)


async def test_a_jump_of_the_stamps_is_told_with_its_size_and_when(window: Make) -> None:
    told = [(n / 10, tf("odom", "base_link", n / 10 + (100 if n < 20 else 0))) for n in range(41)]
    assert "odom → base_link had its stamps jump back by 99.9 s, 2 s ago" in await problems_of(window, *told)


async def test_a_stamp_that_stands_still_is_told_from_a_delay(window: Make) -> None:
    told = [(n / 10, tf("odom", "base_link", min(n, 5) / 10)) for n in range(41)]
    assert "the same stamp again and again, now 3.5 s old" in await problems_of(window, *told)


async def test_simulated_time_that_stands_still_is_told_once_and_not_of_each_edge(window: Make) -> None:
    """Its stamps begin at 0; from 1 s on they do not go on."""
    zero_s = START_NS / SECOND
    edges = (("odom", "base_link"), ("base_link", "laser"))
    told = [(n / 10, tf(*edge, min(n, 10) / 10 - zero_s + 1)) for n in range(41) for edge in edges]
    said = await problems_of(window, *told)
    assert said.startswith("Simulated time stands still since 3 s ago, at 2.000 s of its clock, and all stamps with it")
    assert "stale" not in said and "again and again, now" not in said
    goes_on = [(n / 10, tf(*edge, n / 10 - zero_s + 1)) for n in range(41) for edge in edges]
    assert not await problems_of(window, *goes_on)


def of_topics(*made: Window) -> Recorded:
    """A recording that knows which topics it has."""
    topics = {one.topic: TopicEndpoints(one.topic, [Endpoint("/node", TF, "", "", QoS())], []) for one in made}
    return Recorded(list(made), GraphSnapshot(topics))


async def test_of_a_recording_with_frames_in_one_namespace_only_these_are_read_and_it_is_said(window: Make) -> None:
    moving = window("/robot1/tf", TF, [(n / 10, {"transforms": [tf("odom", "base_link", n / 10)]}) for n in range(11)])
    static = window("/robot1/tf_static", TF, [(0.0, {"transforms": [tf("base_link", "laser", 0)]})])
    tree = await tf_tree(of_topics(moving, static), picture=False)
    assert (tree.frames, tree.problems) == (3, [])
    assert [row.is_static for row in tree.edges] == [False, True]
    assert "These frames are told on /robot1/tf and /robot1/tf_static: the recording has no /tf." in tree.note
    other = window("/robot2/tf", TF, [(0.0, {"transforms": [tf("odom", "base_link", 0)]})])
    with pytest.raises(NoTransform, match="No transform is known at all"):
        await tf_tree(of_topics(moving, other), picture=False)


async def test_a_refused_edge_is_named_by_its_own_parent_and_not_by_an_empty_one(window: Make) -> None:
    wrong = tf("base_link", "camera", 0.1)
    wrong["transform"]["rotation"] = {"w": 0.0}
    said = await problems_of(window, (0.0, tf("odom", "base_link", 0.0)), (0.1, wrong))
    assert "base_link → camera is refused: its rotation is no unit quaternion" in said
    assert "«»" not in said


async def test_a_leading_slash_and_a_clock_of_its_own_are_told(window: Make) -> None:
    told = [(n / 10, tf("/base_link", "/laser", n / 10)) for n in range(11)]
    told += [(n / 10 + 0.01, tf("map", "base_link", n / 10 - 1_000_000_000)) for n in range(11)]
    said = await problems_of(window, *sorted(told, key=lambda pair: pair[0]))
    assert "is told with a leading slash («/base_link → /laser»)" in said
    assert "map → base_link is stamped by simulated time" in said and "unlike the others" in said


async def test_frames_in_a_circle_are_no_healthy_tree(window: Make) -> None:
    edges = (("map", "odom"), ("odom", "base_link"), ("base_link", "map"))
    told = [(n / 10, tf(*edge, n / 10)) for n in range(11) for edge in edges]
    assert "Frames go in a circle, each told to be in the next: " in await problems_of(window, *told)
