"""The watchdog beside keep-out zones: what it lets begin, what it ends, what it latches; and poses by transforms."""

from __future__ import annotations

import math
from typing import Any

import pytest

from ros2_mcp_common.policy.feedback import PoseRule, SpeedRule, Watchdog
from ros2_mcp_common.policy.field_values import Unfit
from ros2_mcp_common.policy.keep_out import KeepOut
from ros2_mcp_common.policy.transform_chain import TransformChain

WALL = KeepOut("p", "map", {"wall": ((2.0, -5.0), (3.0, -5.0), (3.0, 5.0), (2.0, 5.0))}, margin_m=0.2, radius_m=0.2)
SPEED = SpeedRule("/odom", "t", "twist", 1.0, 1.2, 0.5, still={"linear": 0.03, "angular": 0.05})
POSE = PoseRule("/pose", "t", "pose", 1.0, 1.0, "map", keep_out=[WALL])
TF_POSE = PoseRule("/tf", "t", "", 1.0, 1.0, "map", base="base_link", keep_out=[WALL])


def twist(v: float) -> dict[str, Any]:
    zero = {"x": 0.0, "y": 0.0, "z": 0.0}
    return {"twist": {"linear": {**zero, "x": v}, "angular": zero}}


def pose(x: float, yaw: float = 0.0) -> dict[str, Any]:
    turn = {"x": 0.0, "y": 0.0, "z": math.sin(yaw / 2), "w": math.cos(yaw / 2)}
    return {"pose": {"position": {"x": x, "y": 0.0, "z": 0.0}, "orientation": turn}}


def path(*x: float, frame_id: str = "map") -> dict[str, Any]:
    return {"header": {"frame_id": frame_id}, "poses": [{"pose": pose(each)["pose"]} for each in x]}


def edge(parent: str, child: str, x: float, sec: int, yaw: float = 0.0) -> dict[str, Any]:
    turn = {"x": 0.0, "y": 0.0, "z": math.sin(yaw / 2), "w": math.cos(yaw / 2)}
    return {
        "header": {"frame_id": parent, "stamp": {"sec": sec, "nanosec": 0}},
        "child_frame_id": child,
        "transform": {"translation": {"x": x, "y": 0.0, "z": 0.0}, "rotation": turn},
    }


def seen_at(x: float, v: float = 0.0, *, driven: bool = True, yaw: float = 0.0) -> Watchdog:
    """A watchdog that has just heard the robot at x with this speed."""
    watchdog = Watchdog(SPEED, POSE)
    watchdog.told(driven, 100.0, by_goal=driven)
    watchdog.heard_pose(pose(x, yaw), "map", 100.0)
    watchdog.heard_speed(twist(v), 100.0)
    return watchdog


def test_a_robot_is_ended_early_enough_to_stand_before_half_of_the_margin() -> None:
    assert not seen_at(1.0, 0.5).look(100.01), "0.8 m away, it stands after 0.34 m"
    watchdog = seen_at(1.45, 0.5)
    assert "before it could stop, the robot's outline would be 0.0" in watchdog.look(100.01)
    assert not watchdog.latches
    assert not watchdog.look(100.05), "not told again at once"
    assert watchdog.look(100.12), "but as long as it goes on"


def test_away_from_a_zone_and_along_it_a_robot_may_drive() -> None:
    assert not seen_at(1.65, -0.5).look(100.01)
    assert not seen_at(1.65, 0.5, yaw=math.pi / 2).look(100.01)


def test_nearer_than_a_quarter_of_the_margin_the_latch_is_set() -> None:
    watchdog = seen_at(1.76)
    assert "is 0.04 m from the keep-out zone wall" in watchdog.look(100.01) and watchdog.latches
    inside = seen_at(2.5)
    assert "is in the keep-out zone wall" in inside.look(100.01) and inside.latches
    assert not seen_at(2.5, driven=False).look(100.01), "whatever others drive is not ours to end"


def test_goals_of_others_end_where_they_drive_the_robot_towards_a_zone() -> None:
    watchdog = seen_at(1.45, 0.5, driven=False)
    assert not watchdog.look(100.0) and "before it could stop" in watchdog.look_at_others(100.0)
    assert not watchdog.look_at_others(100.1), "its server is asked twice a second"
    assert watchdog.look_at_others(100.6)
    assert not seen_at(1.45, 0.0, driven=False).look_at_others(100.0), "it stands"
    assert not seen_at(1.0, 0.5, driven=False).look_at_others(100.0)
    assert not seen_at(1.45, 0.5).look_at_others(100.0), "our own are ended in another way"


def test_no_goal_begins_where_it_could_not_be_stopped_in_time() -> None:
    assert not seen_at(1.65, driven=False).problem_of_start(100.0)
    assert "only a velocity that leads away" in seen_at(1.72, driven=False).problem_of_start(100.0)


def test_velocities_are_judged_by_where_they_lead() -> None:
    watchdog = seen_at(1.65, driven=False)
    assert watchdog.problem_of_velocity((0.3, 0.0, 0.0), 100.0)
    assert not watchdog.problem_of_velocity((-0.3, 0.0, 0.0), 100.0)
    assert not watchdog.problem_of_velocity((0.0, 0.0, 1.0), 100.0), "a round robot turns on the spot"
    assert watchdog.problem_of_velocity((0.0, 0.0, 0.0001), 100.0) == ""
    nearer = seen_at(1.72, driven=False)
    assert nearer.problem_of_velocity((0.1, 0.0, 0.0), 100.0) and not nearer.problem_of_velocity(
        (-0.1, 0.0, 0.0), 100.0
    )


def test_a_straight_drive_is_judged_to_its_end() -> None:
    watchdog = seen_at(0.0, driven=False)
    assert not watchdog.problem_of_straight(1.5, 100.0) and not watchdog.problem_of_straight(-9.0, 100.0)
    assert "straight ahead, the robot's outline would be" in watchdog.problem_of_straight(1.7, 100.0)
    assert watchdog.problem_of_straight(math.inf, 100.0)
    assert "straight back" in seen_at(0.0, driven=False, yaw=math.pi).problem_of_straight(-1.7, 100.0)


@pytest.mark.parametrize("velocity", [(1e200, 0.0, 0.0), (0.0, 0.0, 1e200), (1e300, 1e300, -1e300)])
def test_speeds_without_measure_are_ends_not_errors(velocity: tuple[float, float, float]) -> None:
    watchdog = seen_at(-900.0)
    assert watchdog.problem_of_velocity((velocity[0], 0.0, 0.0), 100.0) or not velocity[0]
    watchdog.heard_speed(
        {"twist": {"linear": dict(zip("xyz", velocity, strict=True)), "angular": twist(0)["twist"]["linear"]}}, 100.0
    )
    watchdog.look(100.01)


def test_a_robot_that_has_told_no_place_is_not_driven() -> None:
    watchdog = Watchdog(SPEED, POSE)
    for problem in (watchdog.problem_of_start(100.0), watchdog.problem_of_velocity((0.1, 0.0, 0.0), 100.0)):
        assert "/pose has told no pose" in problem
    watchdog.told(False, 100.0)
    watchdog.heard_pose(pose(0.0), "odom", 100.0)
    assert "its frame is 'odom', not 'map'" in watchdog.problem_of_start(100.0)
    watchdog.heard_pose(pose(math.nan), "map", 100.0)
    assert watchdog.problem_of_start(100.0)
    assert not Watchdog(SPEED, PoseRule("/pose", "t", "pose", 1.0, 1.0, "map")).problem_of_start(100.0), "without zones"


def test_a_place_that_falls_silent_while_a_goal_drives_is_latched() -> None:
    watchdog = seen_at(-20.0, 0.3)
    for step in range(60):
        watchdog.told(True, 100.0 + step * 0.02, by_goal=True)
        watchdog.heard_speed(twist(0.3), 100.0 + step * 0.02)
        if found := watchdog.look(100.0 + step * 0.02):
            break
    assert "/pose has sent nothing" in found and watchdog.latches


def test_a_path_into_a_zone_ends_the_drive_that_follows_it() -> None:
    watchdog = seen_at(0.0, 0.1)
    watchdog.heard_plan(path(0.1, 1.0, 1.5))
    assert not watchdog.look(100.01)
    watchdog.heard_plan(path(0.1, 1.0, 2.5))
    assert "on the path that it follows now" in watchdog.look(100.02) and not watchdog.latches
    for other in (path(-5.0, 2.5), path(0.1, 2.5, frame_id="odom"), path(), {"poses": 3}):
        later = seen_at(0.0, 0.1)
        later.heard_plan(other)
        assert not later.look(100.01), "a preview from elsewhere, or nothing that can be judged"


def test_a_pose_by_transforms_is_that_of_the_chain_and_as_old_as_its_oldest_stamp() -> None:
    chain = TransformChain("map", "base_link")
    chain.take({"transforms": [edge("map", "odom", 1.0, 1, yaw=math.pi / 2), edge("odom", "base_link", 2.0, 1)]}, 10.0)
    place, age_s = chain.place(10.2, 0.5)
    assert place == pytest.approx((1.0, 2.0, math.pi / 2)) and age_s == pytest.approx(0.2)
    chain.take({"transforms": [edge("odom", "base_link", 3.0, 2)]}, 10.4)
    assert chain.place(10.4, 0.5)[1] == pytest.approx(0.4), "map to odom is the older one"
    chain.take({"transforms": [edge("map", "odom", 1.0, 1), edge("odom", "base_link", 3.0, 3)]}, 10.6)
    with pytest.raises(Unfit, match="'map' to 'odom' is 0"):
        chain.place(10.6, 0.5)


@pytest.mark.parametrize(
    ("transforms", "why"),
    [
        ([edge("map", "odom", 0.0, 1)], "no transform to 'base_link'"),
        ([edge("odom", "base_link", 0.0, 1)], "no transform to 'odom'"),
        ([edge("base_link", "odom", 0.0, 1), edge("odom", "base_link", 0.0, 1)], "no chain of 16"),
        ([edge("map", "base_link", math.nan, 1)], "not finite"),
        ([edge("map", "base_link", math.inf, 1)], "not finite"),
    ],
)
def test_transforms_that_tell_no_pose_say_why(transforms: list[dict[str, Any]], why: str) -> None:
    chain = TransformChain("map", "base_link")
    chain.take({"transforms": transforms}, 10.0)
    with pytest.raises(Unfit, match=why):
        chain.place(10.0, 0.5)
    watchdog = Watchdog(SPEED, TF_POSE)
    watchdog.told(False, 10.0)
    watchdog.heard_pose({"transforms": transforms}, "", 10.0)
    assert why in watchdog.problem_of_start(10.0)


def test_a_pose_by_transforms_has_to_be_new_when_something_begins() -> None:
    watchdog = Watchdog(SPEED, TF_POSE)
    watchdog.told(False, 10.0)
    watchdog.heard_pose({"transforms": [edge("map", "base_link", 0.0, 1)]}, "", 10.0)
    assert not watchdog.problem_of_start(10.5)
    assert "/tf has told no pose for 1.5 s" in watchdog.problem_of_start(11.5)
