"""The whole tree of frames: as text, as a picture, and what is wrong with it."""

from __future__ import annotations

import io
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from PIL import Image

from ros2_mcp.bags.schema import schema_text
from ros2_mcp.bags.stored import StoredTopic
from ros2_mcp.bags.writer import BagWriter
from ros2_mcp.model.errors import NotFound, NoTransform
from ros2_mcp.model.graph import TopicEndpoints
from ros2_mcp.model.qos import Endpoint, QoS
from ros2_mcp.model.samples import Sample
from ros2_mcp.ops.memory.bag_store import BagStore
from ros2_mcp.ops.sources.bag import open_bag
from ros2_mcp.ops.sources.source import GraphSnapshot, Source
from ros2_mcp.ops.space.tf_tree import Tree, tf_tree
from ros2_mcp.ops.space.unheard import unheard_publishers
from support.made_windows import CODEC, START_NS, Make, Recorded, Window, encoded

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
    assert lines[0] == "8 frames in 2 trees, 2 problems."
    assert any("2 trees, with no transform between them; their roots are map, house." in line for line in lines)
    assert any("map → odom is stale: last published 4 s ago, after 10 Hz." in line for line in lines)
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
    with pytest.raises(NoTransform, match="No transform has been received"):
        await tf_tree(Recorded([window("/odom", "nav_msgs/msg/Odometry", [])]))


async def test_late_stamps_are_told_from_silence_and_what_was_told_once_from_both(window: Make) -> None:
    moving = [(n / 10, {"transforms": [tf("map", "odom", n / 10 - 8)]}) for n in range(51)]
    moving += [(n / 10 + 0.01, {"transforms": [tf("odom", "base_link", n / 10 + 4)]}) for n in range(51)]
    moving += [(1.0, {"transforms": [tf("base_link", "box", 1.0)]})]
    tree = await tf_tree(Recorded([window("/tf", TF, sorted(moving, key=lambda pair: pair[0]))]), picture=False)
    problems = "\n".join(tree.problems)
    assert "map → odom is published now with stamps that are 8" in problems
    assert "odom → base_link is stamped 3.99 s ahead" in problems
    assert "base_link → box was published once" in problems and "/tf_static" in problems


async def problems_of(window: Make, *told: tuple[float, dict[str, Any]]) -> str:
    messages = [(at_s, {"transforms": [one]}) for at_s, one in told]
    return "\n".join((await tf_tree(Recorded([window("/tf", TF, messages)]), picture=False)).problems)


async def test_a_jump_of_the_stamps_is_told_with_its_size_and_when(window: Make) -> None:
    told = [(n / 10, tf("odom", "base_link", n / 10 + (100 if n < 20 else 0))) for n in range(41)]
    assert "odom → base_link has stamps that jumped back by 99.9 s, 2 s ago" in await problems_of(window, *told)


async def test_a_stamp_that_stands_still_is_told_from_a_delay(window: Make) -> None:
    told = [(n / 10, tf("odom", "base_link", min(n, 5) / 10)) for n in range(41)]
    assert "the same stamp again and again, now 3.5 s old" in await problems_of(window, *told)


async def test_simulated_time_that_stands_still_is_told_once_and_not_of_each_edge(window: Make) -> None:
    """Its stamps begin at 0; from 1 s on they do not go on."""
    zero_s = START_NS / SECOND
    edges = (("odom", "base_link"), ("base_link", "laser"))
    told = [(n / 10, tf(*edge, min(n, 10) / 10 - zero_s + 1)) for n in range(41) for edge in edges]
    said = await problems_of(window, *told)
    assert said.startswith("Simulated time stopped 3 s ago, at 2.000 s of its clock, and so did all stamps")
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
    assert "These frames are published on /robot1/tf and /robot1/tf_static: the recording has no /tf." in tree.note
    other = window("/robot2/tf", TF, [(0.0, {"transforms": [tf("odom", "base_link", 0)]})])
    with pytest.raises(NoTransform, match="No transform has been received"):
        await tf_tree(of_topics(moving, other), picture=False)


async def test_a_refused_edge_is_named_by_its_own_parent_and_not_by_an_empty_one(window: Make) -> None:
    wrong = tf("base_link", "camera", 0.1)
    wrong["transform"]["rotation"] = {"w": 0.0}
    said = await problems_of(window, (0.0, tf("odom", "base_link", 0.0)), (0.1, wrong))
    assert "base_link → camera is refused: its rotation is not a unit quaternion" in said
    assert "«»" not in said


async def test_a_leading_slash_and_a_clock_of_its_own_are_told(window: Make) -> None:
    told = [(n / 10, tf("/base_link", "/laser", n / 10)) for n in range(11)]
    told += [(n / 10 + 0.01, tf("map", "base_link", n / 10 - 1_000_000_000)) for n in range(11)]
    said = await problems_of(window, *sorted(told, key=lambda pair: pair[0]))
    assert "is published with a leading slash («/base_link → /laser»)" in said
    assert "map → base_link is stamped by simulated time" in said and "unlike the others" in said


async def test_frames_in_a_circle_are_no_healthy_tree(window: Make) -> None:
    edges = (("map", "odom"), ("odom", "base_link"), ("base_link", "map"))
    told = [(n / 10, tf(*edge, n / 10)) for n in range(11) for edge in edges]
    assert "Frames form a loop: " in await problems_of(window, *told)


async def test_an_edge_that_comes_in_bursts_is_told_with_its_pauses_and_is_not_stale_in_one(window: Make) -> None:
    """As of a serial driver whose buffer is sent every four seconds."""
    messages = [
        ((n // 80 + 1) * 4 + (n % 80) * 1e-4, {"transforms": [tf("odom", "base_link", n / 20)]}) for n in range(240)
    ]
    messages += [(14.9, {"transforms": [tf("base_link", "wheel", 14.9)]})]
    tree = await tf_tree(Recorded([window("/tf", TF, messages)]), picture=False)
    assert tree.edges[0].rate_hz == pytest.approx(20)
    (problem,) = tree.problems[:1]
    assert "odom → base_link comes in bursts: about 80 messages at once, then a pause of about 4 s" in problem
    assert "up to about 4 s late" in problem and "stale" not in problem


async def test_what_is_refused_now_is_told_with_its_last_good_one_and_not_as_silent(window: Make) -> None:
    told = [(n / 10, tf("odom", "base_link", n / 10)) for n in range(21)]
    for n in range(21, 61):
        none = tf("odom", "base_link", n / 10)
        none["transform"]["translation"] = {"x": math.nan}
        told.append((n / 10, none))
    said = await problems_of(window, *told)
    assert "base_link is refused: its translation.x is NaN; the last valid one came 4 s ago" in said
    assert "the last valid one came" in said and "stale" not in said


async def test_several_trees_that_follow_from_a_refused_edge_are_told_last(window: Make) -> None:
    wrong = tf("base_link", "camera", 0.1)
    wrong["transform"]["rotation"] = {"w": 0.0}
    said = await problems_of(window, (0.0, tf("odom", "base_link", 0.0)), (0.1, wrong))
    assert said.splitlines()[-1].startswith("2 trees, with no transform between them")


async def test_two_parents_are_said_of_the_frame_and_a_stamp_ahead_is_no_age(window: Make) -> None:
    parents = ("a", "bc")
    told = [(n / 10, tf(one, "base_link", n / 10 + 0.001 * len(one))) for n in range(21) for one in parents]
    assert (await problems_of(window, *told)).startswith("base_link has two parents at the same time: a and bc")
    ahead = [(n / 10, {"transforms": [tf("map", "odom", n / 10 + 1)]}) for n in range(21)]
    tree = await tf_tree(Recorded([window("/tf", TF, ahead)]), picture=False)
    assert tree.problems == [] and tree.edges[0].age_s == pytest.approx(-1)
    assert "(10 Hz, stamped 1 s ahead)" in "\n".join(tree.lines)


async def test_trees_that_hang_on_a_frame_with_two_parents_are_not_called_apart(window: Make) -> None:
    both = [(n / 10, tf(one, "base_link", n / 10 + 0.001 * len(one))) for n in range(21) for one in ("a", "bc")]
    messages = [(at_s, {"transforms": [one]}) for at_s, one in both]
    tree = await tf_tree(Recorded([window("/tf", TF, messages)]), picture=False)
    assert tree.summary()[0] == "3 frames in one tree, 1 problem."
    messages += [(n / 10 + 0.05, {"transforms": [tf("house", "door", n / 10 + 0.05)]}) for n in range(20)]
    tree = await tf_tree(Recorded([window("/tf", TF, sorted(messages, key=lambda one: one[0]))]), picture=False)
    assert tree.summary()[0] == "5 frames in 2 trees, 2 problems."
    assert tree.problems[-1].startswith("2 trees, with no transform between them; their roots are ")


async def test_the_picture_wraps_what_is_said_of_a_frame(window: Make) -> None:
    told = [(n / 10, tf("/map", f"/{'long' * 15}", n / 10 - 20)) for n in range(11)]
    messages = [(at_s, {"transforms": [one]}) for at_s, one in told]
    tree = await tf_tree(Recorded([window("/tf", TF, messages)]))
    assert len(tree.edges[0].problem) > 160
    assert tree.pictures[0].height >= 4 * 15 and tree.pictures[0].width < 1200


async def test_who_has_the_robots_time_while_the_others_have_simulated_time_is_said(window: Make) -> None:
    zero_s = START_NS / SECOND
    edges = (("odom", "base_link", 0.0), ("base_link", "laser", zero_s), ("base_link", "arm", zero_s))
    told = [(n / 10, tf(parent, child, n / 10 - less_s + 1)) for n in range(41) for parent, child, less_s in edges]
    said = await problems_of(window, *told)
    assert "odom → base_link is stamped by the robot's clock (wall time)" in said and "use_sim_time is not set" in said


async def test_a_pause_in_the_middle_of_a_recording_is_told_with_its_times(window: Make) -> None:
    told = [(n / 10, tf("odom", "base_link", n / 10)) for n in range(200) if not 50 < n < 120]
    said = await problems_of(window, *told)
    assert said.startswith("odom → base_link was silent for 7 s, from 2023-11-14T22:13:25") and "stale" not in said


async def test_what_is_static_holds_in_a_later_part_of_a_recording_whatever_it_says_of_durability(
    tmp_path: Path,
) -> None:
    (tmp_path / "run").mkdir()
    writer = BagWriter(tmp_path / "run", "run")
    definition = schema_text(CODEC.definitions.interface(TF))
    for topic in ("/tf", "/tf_static"):
        writer.add_topic(StoredTopic(topic, TF, None, "ros2msg", definition))
    told = [("/tf_static", 0.0, tf("odom", "base_link", 0)), ("/tf_static", 0.1, tf("base_link", "laser", 0))]
    told += [("/tf", n / 10, tf("map", "odom", n / 10)) for n in range(300)]
    for topic, at_s, one in sorted(told, key=lambda each: each[1]):
        at_ns = START_NS + round(at_s * SECOND)
        writer.write(topic, Sample(at_ns, at_ns, None, encoded(TF, {"transforms": [one]})))
    writer.close()
    store = BagStore(tmp_path)
    tree = await tf_tree(await open_bag(store, "run", "20 s in", "25 s in"), picture=False)
    assert (tree.roots, tree.problems, tree.frames) == (["map"], [], 4)
    assert {row.child for row in tree.edges if row.is_static} == {"base_link", "laser"}
    await store.close()


async def test_frames_of_several_namespaces_are_said_to_be_of_several_robots() -> None:
    class Listener:
        namespace = ""

        async def publishers(self, _topic: str) -> list[Endpoint]:
            return []

        async def other_topics(self) -> list[str]:
            return [f"/robot{number}/{name}" for number in (1, 2) for name in ("tf", "tf_static")]

    said = await unheard_publishers(cast("Source", SimpleNamespace(transforms=Listener())))
    assert "frames of 2 robots, each in its namespace (/robot1, /robot2)" in said[0]
    assert "/robot2/tf_static" in said[0] and "No argument chooses one of them" in said[0]
