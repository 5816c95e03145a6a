"""The robot's joints in words, and the same shorter."""

from __future__ import annotations

import pytest

from ros2_mcp.ops.space.joints import JointNow, joints_in_words, joints_now, without_last_speeds
from ros2_mcp.ops.space.style import Style
from ros2_mcp.world.urdf import parse

LIMIT = '<limit lower="-2.8973" upper="2.8973" velocity="2" effort="1"/>'


def joint(name: str, kind: str, parent: str = "base_link", limit: str = "") -> str:
    link = f'<link name="{name}_link"/>'
    return (
        f'{link}<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{name}_link"/>{limit}</joint>'
    )


CART = parse(
    f"""<robot name="cart"><link name="base_link"/>
    {joint("left_wheel", "continuous")}{joint("right_wheel", "continuous")}
    {joint("caster", "continuous")}{joint("caster_wheel", "continuous", "caster_link")}
    {joint("arm_1", "revolute", limit=LIMIT)}{joint("arm_2", "revolute", "arm_1_link", LIMIT)}</robot>"""
)
TOLD = {"left_wheel": 1.0, "right_wheel": 2.0, "arm_1": 0.5, "arm_2": -1.0, "lamp": 3.0}


BRIEF = Style(is_brief=True, decimals=2)


def test_casters_that_nobody_tells_are_nobody_s_concern_and_limits_are_rounded_inwards() -> None:
    assert joints_in_words(joints_now(CART, TOLD), Style()) == [
        "arm_1 0.5 of ±2.897 rad, ≤ 2 rad/s",
        "arm_2 -1 of ±2.897 rad, ≤ 2 rad/s",
        "left_wheel continuous 1 rad",
        "right_wheel continuous 2 rad",
        "lamp 3 (no unit)",
    ]


def test_where_it_must_be_brief_wheels_and_chains_stand_in_one_line_each() -> None:
    assert joints_in_words(joints_now(CART, TOLD), BRIEF) == [
        "arm_{1,2} 0.5, -1 of ±2.89, 2/s",
        "{left,right}_wheel continuous 1, 2",
        "lamp 3 (no unit)",
    ]


def test_a_joint_that_follows_another_is_told_where_somebody_tells_it() -> None:
    follows = joint("RHip", "revolute", limit=LIMIT + '<mimic joint="LHip" multiplier="-1"/>')
    urdf = parse(f'<robot name="r"><link name="base_link"/>{joint("LHip", "revolute", limit=LIMIT)}{follows}</robot>')
    rows = joints_now(urdf, {"LHip": 0.1, "RHip": -0.1})
    assert joints_in_words(rows, Style())[1] == "RHip -0.1 of ±2.897 rad, ≤ 2 rad/s, mimics LHip"
    assert joints_in_words(rows, BRIEF) == ["{L,R}Hip 0.1, -0.1 of ±2.89, 2/s"]
    assert joints_in_words(joints_now(urdf, {"LHip": 0.1}), BRIEF) == ["LHip 0.1 of ±2.89, 2/s"]


def test_a_speed_that_all_have_is_told_once_after_those_that_have_it() -> None:
    rows = [JointNow(name, at=0, speed=speed, unit="rad") for name, speed in (("pan", 1.5), ("wheel", 0.0))]
    rows += [JointNow(name, at=0, speed=1.5, unit="rad") for name in ("tilt", "elbow")]
    assert joints_in_words(rows, BRIEF) == ["pan 0", "tilt 0", "elbow 0", "all these 1.5/s", "wheel 0"]
    assert joints_in_words(rows[:3], BRIEF) == ["pan 0, 1.5/s", "wheel 0", "tilt 0, 1.5/s"]


def test_speeds_are_left_out_row_by_row_from_the_last_one() -> None:
    rows = [JointNow(name, at=0, speed=speed, unit="rad") for name, speed in (("pan", 1.0), ("a_1", 2.0), ("a_2", 3.0))]
    found, count = without_last_speeds(rows)
    assert (joints_in_words(found, BRIEF), count) == (["pan 0, 1/s", "a_{1,2} 0"], 2)
    found, count = without_last_speeds(found)
    assert ([one.speed for one in found], count) == ([0.0, 0.0, 0.0], 1)


def test_limits_that_are_none_break_nothing() -> None:
    far = '<limit lower="-1e307" upper="1e16" velocity="1" effort="1"/>'
    urdf = parse(f'<robot name="r"><link name="base_link"/>{joint("lift", "prismatic", limit=far)}</robot>')
    told = joints_in_words(joints_now(urdf, {"lift": 0.5}), Style())
    assert told == ["lift prismatic 0.5 of -1e+307..1e+16 m, ≤ 1 m/s"]


def test_joints_of_two_sides_or_four_corners_are_told_together() -> None:
    rows = [
        JointNow("LHipPitch", at=0.1, span=(-1.5, 0.4)),
        JointNow("RHipPitch", at=0.2, span=(-1.5, 0.4)),
        JointNow("LHipRoll", at=0.1, span=(-0.379, 0.79)),
        JointNow("RHipRoll", at=0.1, span=(-0.79, 0.379)),
        JointNow("FL_hip_joint", at=0, span=(-1.0, 1.0)),
        JointNow("RR_hip_joint", at=0.5, span=(-1.0, 1.0)),
        JointNow("front_left_hip_x", at=1, span=(0.0, 2.0)),
        JointNow("rear_right_hip_x", at=2, span=(0.0, 2.0)),
        JointNow("wheel_left", at=3, span=(-4.0, 4.0)),
        JointNow("wheel_right", span=(-4.0, 3.0)),
        JointNow("Lift", at=1, span=(0.0, 2.0)),
    ]
    assert joints_in_words(rows, BRIEF) == [
        "{L,R}HipPitch 0.1, 0.2 of -1.5..0.4",
        "{L,R}HipRoll 0.1 of -0.37..0.79, mirrored",
        "{FL,RR}_hip_joint 0, 0.5 of ±1",
        "{front_left,rear_right}_hip_x 1, 2 of 0..2",
        "wheel_{left,right} 3, unknown of ±4, -4..3",
        "Lift 1 of 0..2",
    ]


@pytest.mark.parametrize(
    ("speed", "exact", "coarse"),
    [(1.3963, "1.39", "1.3"), (24.67, "24.6", "24"), (123.6, "123", "120"), (0.09999, "0.0999", "0.099")],
)
def test_a_speed_limit_is_rounded_down(speed: float, exact: str, coarse: str) -> None:
    limit = f'<limit lower="-1" upper="1" velocity="{speed}" effort="1"/>'
    rows = joints_now(
        parse(f'<robot name="r"><link name="base_link"/>{joint("wrist", "revolute", limit=limit)}</robot>'),
        {"wrist": 0.0},
    )
    assert joints_in_words(rows, Style()) == [f"wrist 0 of ±1 rad, ≤ {exact} rad/s"]
    assert joints_in_words(rows, BRIEF) == [f"wrist 0 of ±1, {coarse}/s"]
