"""The robot's joints in words, and the same shorter."""

from __future__ import annotations

from ros2_mcp.codec.urdf import parse
from ros2_mcp.ops.space.joints import joints_in_words, with_chains, with_turning_together, without_speeds

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


def test_casters_that_nobody_tells_are_nobody_s_concern_and_limits_are_rounded_inwards() -> None:
    assert joints_in_words(CART, TOLD) == [
        "arm_1 now 0.5 of -2.897..2.897 rad, ≤ 2 rad/s",
        "arm_2 now -1 of -2.897..2.897 rad, ≤ 2 rad/s",
        "left_wheel continuous now 1 rad",
        "right_wheel continuous now 2 rad",
        "lamp now 3",
    ]


def test_what_is_too_long_loses_speeds_then_has_wheels_and_chains_in_one_line_each() -> None:
    short = with_chains(with_turning_together(without_speeds(joints_in_words(CART, TOLD))))
    assert short == [
        "arm_1,2 now 0.5, -1 of -2.897..2.897",
        "lamp now 3",
        "continuous: left_wheel 1, right_wheel 2",
    ]


def test_limits_that_are_none_break_nothing() -> None:
    far = '<limit lower="-1e307" upper="1e16" velocity="1" effort="1"/>'
    urdf = parse(f'<robot name="r"><link name="base_link"/>{joint("lift", "prismatic", limit=far)}</robot>')
    assert joints_in_words(urdf, {"lift": 0.5}) == ["lift prismatic now 0.5 of -1e+307..1e+16 m, ≤ 1 m/s"]


def test_joints_of_two_sides_or_four_corners_are_told_together() -> None:
    lines = [
        "LHipPitch now 0.1 of -1.5..0.4",
        "RHipPitch now 0.2 of -1.5..0.4",
        "FL_hip_joint now 0 of -1..1",
        "RR_hip_joint now 0.5 of -1..1",
        "left_knee now 1 of 0..2",
        "right_knee now 2 of 0..2",
        "wheel_left now 3 of -4..4",
        "wheel_right now 4 of -4..3",
        "Lift now 1 of 0..2",
    ]
    assert with_chains(lines) == [
        "L,RHipPitch now 0.1, 0.2 of -1.5..0.4",
        "FL,RR_hip_joint now 0, 0.5 of -1..1",
        "left,right_knee now 1, 2 of 0..2",
        "wheel_left,right now 3, 4 of -4..4, -4..3",
        "Lift now 1 of 0..2",
    ]


def test_a_speed_limit_is_rounded_down() -> None:
    limit = '<limit lower="-1" upper="1" velocity="1.3963" effort="1"/>'
    urdf = parse(f'<robot name="r"><link name="base_link"/>{joint("wrist", "revolute", limit=limit)}</robot>')
    assert joints_in_words(urdf, {"wrist": 0.0}) == ["wrist now 0 of -1..1 rad, ≤ 1.39 rad/s"]
