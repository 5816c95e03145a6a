"""The tree of frames: the same numbers as a second implementation, tf2's rules, bounds, and reasons in words."""

from __future__ import annotations

import math
import random
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ros2_mcp.model.errors import NoTransform
from ros2_mcp.model.poses import Pose, about_z, from_roll_pitch_yaw, mean_of, normalised
from ros2_mcp.world.frame_edges import KEPT_NS
from ros2_mcp.world.no_transform import located
from ros2_mcp.world.transforms import MOST_FRAMES, MOST_KEPT, FrameTree
from support.agent import FULL
from support.made_frames import NOW_NS, SECOND, at, follows, reason, robot, tell, transform
from support.second_tf import Matrix, SecondTree, matrix

# ── the same numbers ─────────────────────────────────────────────────────────────────────────────────────────────────


def random_rotation(chance: random.Random) -> tuple[float, ...]:
    q = normalised(tuple(chance.gauss(0, 1) for _ in range(4)))  # pyright: ignore[reportArgumentType]
    return q if chance.random() < 0.5 else tuple(-part for part in q)


def random_trees(chance: random.Random) -> tuple[FrameTree, SecondTree, list[str]]:
    """The same random forest twice: up to 12 frames, a third of them static, stamps at random within ten seconds."""
    tree, told = FrameTree(), dict[str, tuple[str, Mapping[int | None, Matrix]]]()
    names = [f"frame_{number}" for number in range(chance.randint(2, 12))]
    messages: list[tuple[int, Any]] = []
    for number, child in enumerate(names[1:], 1):
        parent = names[chance.randrange(number)]
        is_static = chance.random() < 0.33
        stamps = [None] if is_static else sorted({at(chance.uniform(0, 10)) for _ in range(chance.randint(1, 8))})
        steps: dict[int | None, Matrix] = {}
        for stamp in stamps:
            where, q = tuple(chance.uniform(-50, 50) for _ in range(3)), random_rotation(chance)
            steps[stamp] = matrix(where, q)
            messages.append((stamp or 0, transform(parent, child, where, q, stamp or 0)))
        told[child] = parent, steps
    for stamp, message in sorted(messages, key=lambda pair: pair[0]):
        tree.add(SimpleNamespace(transforms=[message]), stamp, is_static=not stamp)
    return tree, SecondTree(told), names


def test_random_trees_and_times_give_what_a_second_implementation_gives() -> None:
    """Within 1e-9 (m, and parts of the rotation); 10,000 trees in all rounds, each asked at four times."""
    chance = random.Random(14)
    found_some = missed_some = 0
    worst = 0.0
    for _ in range(10_000 if FULL else 400):
        tree, second, names = random_trees(chance)
        for at_ns in (None, *(at(chance.uniform(-1, 11)) for _ in range(3))):
            target, frame = chance.choice(names), chance.choice(names)
            asked_ns = second.latest(target, frame) if at_ns is None else at_ns
            expected = second.lookup(target, frame, at(0) if asked_ns is None else asked_ns)
            found = tree.find(target, frame, at_ns)
            if expected is None or found is None:
                assert expected is None and found is None
                missed_some += 1
                continue
            worst = max(worst, float(np.abs(matrix(found.pose.translation, found.pose.rotation) - expected).max()))
            found_some += 1
    print(f"{found_some} found, {missed_some} not; at most {worst:.2g} apart")
    assert worst < 1e-9
    assert found_some > missed_some > 100


# ── tf2's rules ──────────────────────────────────────────────────────────────────────────────────────────────────────


def test_between_two_stamps_the_place_goes_straight_and_the_rotation_the_shorter_way() -> None:
    tree = FrameTree()
    tell(tree, transform("odom", "base", (1.0, 0.0, 0.0), about_z(math.radians(170)), at(0)))
    tell(tree, transform("odom", "base", (3.0, 2.0, 0.0), about_z(math.radians(-170)), at(1)), after_s=1)
    pose = located(tree, "odom", "base", at(0.25)).pose
    assert pose.translation == pytest.approx((1.5, 0.5, 0.0))
    assert math.degrees(pose.yaw_rad) == pytest.approx(175)


def test_a_pose_is_that_of_the_second_frame_in_the_first_and_its_inverse_the_other_way_round() -> None:
    tree = FrameTree()
    tell(tree, transform("base", "laser", (0.2, 0.0, 0.3)), static=True)
    assert located(tree, "base", "laser").pose.translation == (0.2, 0.0, 0.3)
    found = located(tree, "laser", "/base")
    assert found.pose.translation == (-0.2, 0.0, -0.3)
    assert (found.chain, found.stamp_ns) == (["base", "laser"], None)


def test_the_latest_is_the_newest_time_that_all_edges_have() -> None:
    tree = FrameTree()
    follows(tree, "map", "odom", 0, 3, hz=1)
    follows(tree, "odom", "base", 0, 3.5)
    tell(tree, transform("base", "laser"), static=True)
    found = located(tree, "map", "laser")
    assert found.stamp_ns == at(3)
    assert found.pose.translation == pytest.approx((6.0, 0.0, 0.0))
    assert found.chain == ["laser", "base", "odom", "map"]


def test_a_static_transform_that_is_told_again_replaces_the_first_and_of_a_repeated_stamp_the_first_counts() -> None:
    tree = FrameTree()
    tell(tree, transform("base", "laser", (1.0, 0.0, 0.0)), static=True)
    tell(tree, transform("base", "laser", (2.0, 0.0, 0.0)), static=True)
    assert located(tree, "base", "laser").pose.translation[0] == 2.0
    for x in (1.0, 2.0):
        tell(tree, transform("odom", "base", (x, 0.0, 0.0)))
    assert located(tree, "odom", "base").pose.translation[0] == 1.0
    assert tree.edges["base"].repeated == 1


def test_a_frame_that_is_given_another_parent_has_the_one_of_each_time() -> None:
    tree = FrameTree()
    for frame in ("table", "gripper"):
        tell(tree, transform("world", frame, (1.0 if frame == "table" else 5.0, 0.0, 0.0)), static=True)
    follows(tree, "table", "cup", 0, 1)
    for number in range(11, 20):
        tell(tree, transform("gripper", "cup", stamp_ns=at(number / 10)), after_s=number / 10)
    assert located(tree, "world", "cup", at(0.5)).pose.translation[0] == pytest.approx(1.5)
    assert located(tree, "world", "cup").pose.translation[0] == 5.0


def test_a_transform_without_a_stamp_holds_for_all_times_and_is_counted() -> None:
    tree = FrameTree()
    tell(tree, transform("odom", "base", (1.0, 0.0, 0.0), stamp_ns=0))
    assert located(tree, "odom", "base", at(5)).pose.translation[0] == 1.0
    assert tree.edges["base"].unstamped == 1


def test_roll_pitch_and_yaw_are_those_that_a_rotation_was_made_of_also_straight_up() -> None:
    for angles in ((0.1, -0.2, 3.0), (-3.0, 1.5, -2.0)):
        assert Pose(rotation=from_roll_pitch_yaw(*angles)).roll_pitch_yaw_rad == pytest.approx(angles)
    up = Pose(rotation=from_roll_pitch_yaw(0.0, math.pi / 2, 0.3)).roll_pitch_yaw_rad
    assert up == pytest.approx((0.0, math.pi / 2, 0.3))


def test_the_mean_of_poses_is_in_their_middle_whatever_the_signs_of_their_quaternions() -> None:
    turned = [about_z(math.radians(angle)) for angle in (175, -175)]
    poses = [Pose((1.0, 0.0, 0.0), turned[0]), Pose((3.0, 0.0, 0.0), tuple(-part for part in turned[1]))]  # pyright: ignore[reportArgumentType]
    mean = mean_of(poses)
    assert mean.translation[0] == 2.0
    assert abs(math.degrees(mean.yaw_rad)) == pytest.approx(180)


# ── bounds ───────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_a_tree_is_bounded_in_time_in_transforms_and_in_frames() -> None:
    tree = FrameTree()
    follows(tree, "odom", "base", 0, 200, hz=5)
    assert tree.edges["base"].stamps[0] >= at(200) - 2 * KEPT_NS
    follows(tree, "odom", "fast", 0, 12, hz=1000)
    assert len(tree.edges["fast"].moving) <= MOST_KEPT
    for number in range(MOST_FRAMES + 10):
        tell(tree, transform("odom", f"made_{number}"), static=True)
    assert len(tree.edges) == MOST_FRAMES
    assert tree.left_out == 12


def test_around_a_time_of_a_recording_what_is_near_to_it_is_kept() -> None:
    tree = FrameTree(around_ns=at(3))
    follows(tree, "odom", "base", 0, 20, hz=1000)
    assert tree.edges["base"].stamps[0] <= at(3 - MOST_KEPT / 4000)
    assert located(tree, "odom", "base", at(3)).pose.translation[0] == pytest.approx(3.0)


# ── reasons ──────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_nothing_told_at_all_is_said() -> None:
    why, words = reason(FrameTree(), "map", "base_link")
    assert why == "never published" and "/tf" in words


def test_an_unknown_frame_is_told_with_the_nearest_name() -> None:
    why, words = reason(robot(), "map", "base_lnik")
    assert why == "unknown frame"
    assert "base_lnik" in words and "Did you mean base_link?" in words


def test_two_trees_are_told_with_their_roots_and_what_is_missing() -> None:
    tree = FrameTree()
    follows(tree, "odom", "base_link", 0, 1)
    tell(tree, transform("map", "door"), static=True)
    why, words = reason(tree, "map", "base_link")
    assert why == "two trees"
    assert "base_link is in the tree of odom" in words and "map → odom" in words and "localisation" in words


def test_where_odom_is_below_the_map_it_is_the_edge_to_the_base_that_is_missing() -> None:
    tree = FrameTree()
    follows(tree, "map", "odom", 0, 1)
    tell(tree, transform("base_footprint", "base_link"), static=True)
    assert "odom → base_footprint has no publisher" in reason(tree, "odom", "base_link")[1]
    footprint = FrameTree()
    follows(footprint, "odom", "base_footprint", 0, 1)
    tell(footprint, transform("base_link", "laser"), static=True)
    assert "Publish a transform between base_link and odom" in reason(footprint, "odom", "laser")[1]


def test_two_parents_at_the_same_time_are_told_with_their_rates() -> None:
    tree = robot()
    for number in range(20):
        tell(tree, transform("map", "base_link", stamp_ns=at(9.03 + number / 20)), after_s=9.03 + number / 20)
    why, words = reason(tree, "map", "laser")
    assert why == "two parents"
    assert "base_link" in words and "odom (" in words and "map (" in words and "Hz" in words


def test_two_static_parents_are_two_parents() -> None:
    tree = robot()
    tell(tree, transform("chassis", "laser"), static=True)
    assert reason(tree, "base_link", "laser")[0] == "two parents"


def test_a_circle_is_told_with_its_frames() -> None:
    tree = FrameTree()
    tell(tree, transform("a", "b"), transform("b", "c"), transform("c", "a"), static=True)
    tell(tree, transform("map", "odom"), static=True)
    why, words = reason(tree, "map", "a")
    assert why == "circle"
    assert "a is in c, c is in b, b is in a" in words
    why, words = reason(tree, "b", "a")
    assert why == "circle" and "a is in c, c is in b, b is in a" in words, "no pose, although an edge joins the two"
    assert tree.roots == ["a", "map"]


def test_clocks_that_differ_are_each_told() -> None:
    tree = FrameTree()
    tell(tree, transform("map", "odom"))
    tell(tree, transform("odom", "base_link", stamp_ns=at(30.0)))
    why, words = reason(tree, "map", "base_link")
    assert why == "two clocks"
    assert "map → odom by the robot's (wall time), odom → base_link 30 s in the future (another computer's" in words


def test_an_edge_that_is_told_seldom_says_so() -> None:
    tree = FrameTree()
    for second in (0.0, 5.0, 10.0):
        tell(tree, transform("map", "odom", stamp_ns=at(second)), after_s=second)
    why, words = reason(tree, "map", "odom", at(12.0))
    assert why == "not at that time" and "It is published only every 5 s." in words


def test_a_time_that_nobody_told_names_the_nearest_and_how_far_it_is() -> None:
    why, words = reason(robot(), "odom", "base_link", at(12.5))
    assert why == "not at that time" and "2.5 s earlier" in words
    why, words = reason(robot(), "odom", "base_link", at(-4))
    assert why == "not at that time" and "4 s later" in words


def test_an_edge_that_ended_long_ago_is_stale() -> None:
    tree = robot()
    follows(tree, "odom", "base_link", 10.1, 120)  # and map → odom no more
    why, words = reason(tree, "map", "base_link")
    assert why == "stale"
    assert "map → odom ends 110 s before odom → base_link" in words


def test_stamps_of_two_clocks_are_told_from_staleness() -> None:
    tree = FrameTree()
    for number in range(20):
        tell(tree, transform("map", "odom", stamp_ns=round((100 + number / 10) * SECOND)), after_s=number / 10)
    follows(tree, "odom", "base_link", 0, 2)
    why, words = reason(tree, "map", "base_link")
    assert why == "two clocks" and "simulated time" in words


def test_stamps_that_jump_back_are_told_and_count_from_there_on() -> None:
    tree = robot()
    for number in range(10):
        stamp = at(-100 + number / 10)
        tell(tree, transform("odom", "base_link", (7.0, 0.0, 0.0), stamp_ns=stamp), after_s=10.1 + number / 10)
    assert located(tree, "odom", "base_link").pose.translation[0] == 7.0
    why, words = reason(tree, "odom", "base_link", at(5))
    assert why == "clock jump" and "jumped back by 110 s" in words
    assert reason(tree, "map", "base_link")[0] == "clock jump"


def test_a_transform_that_is_none_is_refused_for_a_reason() -> None:
    tree = FrameTree()
    tell(tree, transform("odom", "base_link", q=(0.0, 0.0, 0.0, 0.0)))
    tell(tree, transform("map", "odom", (math.nan, 0.0, 0.0)))
    assert "not a unit quaternion" in reason(tree, "odom", "base_link")[1]
    assert "its translation.x is NaN" in reason(tree, "map", "odom")[1]
    tell(tree, transform("self", "self"))
    assert "its own parent" in tree.edges["self"].refused


def test_two_publishers_of_one_edge_are_told_apart_by_the_numbers_of_their_messages() -> None:
    tree = FrameTree()
    for number in range(20):
        stamp = at(number / 10)
        tell(tree, transform("odom", "base", stamp_ns=stamp), after_s=number / 10, sequence=500 + number)
        tell(tree, transform("odom", "base", stamp_ns=stamp + SECOND // 20), after_s=number / 10, sequence=7 + number)
        tell(tree, transform("map", "odom", stamp_ns=stamp), after_s=number / 10, sequence=500 + number)
    assert len(tree.edges["base"].writers) == 2
    assert len(tree.edges["odom"].writers) == 1
    assert tree.edges["odom"].writers[0] not in tree.edges["base"].writers


# ── what several tell, and how ───────────────────────────────────────────────────────────────────────────────────────


def test_a_second_publisher_that_has_ended_no_longer_counts() -> None:
    tree = FrameTree()
    for step in range(20):
        tell(tree, transform("odom", "base", stamp_ns=at(step / 10)), after_s=step / 10, sequence=step + 1)
        if step < 10:
            tell(
                tree,
                transform("world", "base", stamp_ns=at(step / 10 + 0.05)),
                after_s=step / 10 + 0.05,
                sequence=5_000 + step,
            )
    edge = tree.edges["base"]
    assert edge.two_parents and len(edge.writers) == 2
    for step in range(20, 25):
        tell(tree, transform("odom", "base", stamp_ns=at(step / 10)), after_s=step / 10, sequence=step + 1)
    assert not edge.two_parents and edge.parents == ["odom"] and len(edge.writers) == 1
    assert tree.find("odom", "base") is not None


def test_what_two_publishers_tell_of_an_edge_is_compared_for_one_time() -> None:
    tree = FrameTree()
    for number in range(20):
        for first, x, late_s in ((1, 0.0, 0.0), (500, 0.5, 0.02)):
            when = number * 0.05 + late_s
            tell(
                tree,
                transform("odom", "base", (x + when, 0.0, 0.0), stamp_ns=at(when)),
                after_s=when,
                sequence=first + number,
            )
    assert tree.edges["base"].apart == pytest.approx((0.5, 0.0), abs=1e-6)


def test_one_publisher_is_not_apart_from_itself() -> None:
    tree = FrameTree()
    for number in range(20):
        one = transform("odom", "base", (number * 0.1, 0.0, 0.0), stamp_ns=at(number * 0.05))
        tell(tree, one, after_s=number * 0.05, sequence=number + 1)
    assert tree.edges["base"].apart is None


def test_two_publishers_with_the_same_stamps_are_compared_too() -> None:
    tree = FrameTree()
    for number in range(20):
        for first, x in ((1, 0.0), (500, 0.3)):
            one = transform("odom", "base", (x, 0.0, 0.0), stamp_ns=at(number * 0.05))
            tell(tree, one, after_s=number * 0.05, sequence=first + number)
    assert tree.edges["base"].apart == pytest.approx((0.3, 0.0), abs=1e-6)


def test_two_fixed_mounts_of_one_sensor_are_apart() -> None:
    tree = FrameTree()
    tell(tree, transform("base", "laser", (0.2, 0.0, 0.0)), static=True, sequence=1)
    tell(tree, transform("base", "laser", (0.25, 0.0, 0.0)), static=True, sequence=1)
    assert tree.edges["laser"].apart == pytest.approx((0.05, 0.0), abs=1e-6)


def test_a_leading_slash_is_taken_off_and_remembered() -> None:
    tree = FrameTree()
    tell(tree, transform("/base", "/laser"), static=True)
    assert tree.find("base", "laser") and tree.edges["laser"].slashed == "/base → /laser"
    tell(tree, transform("base", "laser"), static=True)
    assert tree.edges["laser"].slashed == ""


def test_of_as_many_edges_by_two_clocks_the_receivers_is_the_one_that_counts() -> None:
    tree = FrameTree()
    tell(tree, transform("map", "odom", stamp_ns=50 * SECOND))
    tell(tree, transform("odom", "base"))
    assert tree.clock_ns == 0
    tell(tree, transform("base", "arm", stamp_ns=50 * SECOND))
    assert tree.clock_ns == NOW_NS - 50 * SECOND


def test_a_frame_that_is_told_to_be_its_own_parent_stays_refused_while_another_tells_its_parent() -> None:
    tree = FrameTree()
    tell(tree, transform("base", "base"), static=True)
    follows(tree, "odom", "base", 0.0, 1.0)
    assert tree.edges["base"].refused == "it is published as its own parent"
    assert tree.find("odom", "base")


def test_of_two_edges_the_one_whose_stamps_jumped_is_named_with_how_far() -> None:
    tree = FrameTree()
    for number in range(20):
        tell(tree, transform("map", "odom", stamp_ns=at(number / 10)), after_s=number / 10)
        ahead_s = 120 if number > 10 else 0
        tell(tree, transform("odom", "base", stamp_ns=at(number / 10 + ahead_s)), after_s=number / 10)
    assert tree.clock_ns == 0
    with pytest.raises(NoTransform, match="the stamps of odom → base jumped forward by 120 s"):
        located(tree, "map", "base")


def test_two_parents_are_the_reason_of_two_trees() -> None:
    tree = FrameTree()
    tell(tree, transform("footprint", "base"), transform("map", "footprint"), static=True, sequence=1)
    tell(tree, transform("lidar", "base"), static=True, sequence=1)
    with pytest.raises(NoTransform, match="base has 2 parents"):
        located(tree, "map", "lidar")


def test_a_blank_at_the_end_of_a_name_is_told() -> None:
    tree = FrameTree()
    tell(tree, transform("base", "lidar "), static=True)
    with pytest.raises(NoTransform, match="published with a space before or after its name"):
        located(tree, "base", "lidar")


def test_two_names_of_trees_that_are_nearly_the_same_are_told() -> None:
    tree = FrameTree()
    follows(tree, "odom", "base_footprnt", 0, 1)
    tell(tree, transform("base_footprint", "base_link"), static=True)
    why, words = reason(tree, "odom", "base_link")
    assert why == "two trees" and "base_footprint and base_footprnt are nearly the same name" in words


@pytest.mark.parametrize(
    ("child", "root", "said"),
    [
        ("odom", "robot1/odom", "differ by a prefix alone"),
        ("odm", "odom", "nearly the same name"),
        ("robot1/base", "robot2/base", ""),
        ("leg_1", "leg_2", ""),
        ("left_wheel", "right_wheel", ""),
        ("base_link", "base_footprint", ""),
    ],
)
def test_names_that_may_be_meant_to_be_one_are_told_from_those_of_two_things(child: str, root: str, said: str) -> None:
    tree = FrameTree()
    tell(tree, transform("map", child), static=True)
    tell(tree, transform(root, "tip"), static=True)
    words = reason(tree, "map", "tip")[1]
    assert said in words if said else "nearly" not in words and "prefix" not in words


def test_stamps_a_few_seconds_in_the_future_are_another_clock_and_nothing_that_begins_soon() -> None:
    tree = FrameTree()
    for number in range(20):
        seconds = number / 20
        tell(tree, transform("map", "odom", stamp_ns=at(seconds)), after_s=seconds)
        tell(tree, transform("odom", "base_link", stamp_ns=at(seconds + 5)), after_s=seconds)
    why, words = reason(tree, "map", "base_link")
    assert why == "two clocks" and "odom → base_link 5 s in the future (another computer's clock?)" in words
    why, words = reason(tree, "odom", "base_link", at(1))
    assert why == "not at that time" and "Its stamps are 5 s ahead of the time when it came." in words


def test_of_two_edges_on_simulated_time_the_one_that_is_ahead_is_told() -> None:
    tree = FrameTree()
    for number in range(20):
        tell(tree, transform("map", "odom", stamp_ns=(100 + number) * SECOND // 20), after_s=number / 20)
        tell(tree, transform("odom", "base_link", stamp_ns=(300 + number) * SECOND // 20), after_s=number / 20)
    why, words = reason(tree, "map", "base_link")
    assert why == "two clocks" and "map → odom by simulated time, 10 s behind the others" in words


def moves(tree: FrameTree, places: list[float], hz: float = 20.0, yaws: list[float] | None = None) -> None:
    for number, x in enumerate(places):
        yaw = yaws[number] if yaws else 0.0
        one = transform("odom", "base_link", (x, 0.0, 0.0), about_z(yaw), stamp_ns=at(number / hz))
        tell(tree, one, after_s=number / hz, sequence=number + 1)


def test_a_jump_of_the_place_is_told_from_motion_however_fast() -> None:
    tree = FrameTree()
    moves(tree, [0.05 * n + (5.0 if n >= 10 else 0.0) for n in range(20)])
    (leap,) = tree.edges["base_link"].leaps
    assert leap.far_m == pytest.approx(5.05) and leap.within_ns == pytest.approx(SECOND / 20)
    assert leap.received_ns == at(10 / 20)
    for places in ([2.0 * n for n in range(20)], [0.0] * 10 + [1.5 * n for n in range(10)], [0.0, 5.0]):
        fast = FrameTree()
        moves(fast, places)
        assert not fast.edges["base_link"].leaps, "a car, one that starts, and what nothing is known beside"
    turned = FrameTree()
    moves(turned, [0.0] * 20, yaws=[0.0] * 10 + [2.0] * 10)
    assert turned.edges["base_link"].leaps[0].turned_deg == pytest.approx(math.degrees(2.0))
    spinning = FrameTree()
    moves(spinning, [0.0] * 20, yaws=[0.0] * 10 + [1.0 * n for n in range(10)])
    assert not spinning.edges["base_link"].leaps


def test_two_publishers_of_one_edge_that_disagree_do_not_make_it_jump() -> None:
    tree = FrameTree()
    for number in range(20):
        for first, x in ((1, 0.0), (500, 3.0)):
            one = transform("odom", "base_link", (x, 0.0, 0.0), stamp_ns=at(number / 20) + first)
            tell(tree, one, after_s=number / 20, sequence=first + number)
    assert not tree.edges["base_link"].leaps


def test_the_rate_of_an_edge_outlasts_a_jump_of_its_stamps() -> None:
    tree = FrameTree()
    follows(tree, "odom", "base_link", 0, 4, hz=20)
    for number in range(1, 3):
        tell(tree, transform("odom", "base_link", stamp_ns=at(number / 30)), after_s=4 + number / 20)
    edge = tree.edges["base_link"]
    assert edge.jumps and len(edge.moving) == 2 and edge.rate_hz == pytest.approx(20)
