"""The robot's joints in words: one line for each."""

from __future__ import annotations

from collections.abc import Mapping

import pytest

from ros2_mcp.ops.space.joints import JointNow, joints_now
from ros2_mcp.world.urdf import Urdf, parse

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


def lines(urdf: Urdf, positions: Mapping[str, float]) -> list[str]:
    return [one.line for one in joints_now(urdf, positions)]


def test_casters_that_nobody_tells_are_nobody_s_concern_and_limits_are_rounded_inwards() -> None:
    assert lines(CART, TOLD) == [
        "arm_1 0.5 rad, limits -2.897 to 2.897 rad, at most 2 rad/s",
        "arm_2 -1 rad, limits -2.897 to 2.897 rad, at most 2 rad/s",
        "left_wheel continuous 1 rad",
        "right_wheel continuous 2 rad",
        "lamp 3 (no unit)",
    ]


def test_a_joint_that_follows_another_is_told_where_somebody_tells_it() -> None:
    follows = joint("RHip", "revolute", limit=LIMIT + '<mimic joint="LHip" multiplier="-1"/>')
    urdf = parse(f'<robot name="r"><link name="base_link"/>{joint("LHip", "revolute", limit=LIMIT)}{follows}</robot>')
    follower = "RHip -0.1 rad, limits -2.897 to 2.897 rad, at most 2 rad/s, mimics LHip"
    assert lines(urdf, {"LHip": 0.1, "RHip": -0.1})[1] == follower
    assert lines(urdf, {"LHip": 0.1}) == ["LHip 0.1 rad, limits -2.897 to 2.897 rad, at most 2 rad/s"]


def test_limits_that_are_none_break_nothing() -> None:
    far = '<limit lower="-1e307" upper="1e16" velocity="1" effort="1"/>'
    urdf = parse(f'<robot name="r"><link name="base_link"/>{joint("lift", "prismatic", limit=far)}</robot>')
    assert lines(urdf, {"lift": 0.5}) == ["lift prismatic 0.5 m, limits -1e+307 to 1e+16 m, at most 1 m/s"]


def test_a_joint_of_which_nobody_tells_the_position_has_its_limits() -> None:
    known = JointNow("wheel_left", at=3, span=(-4.0, 4.0), unit="rad")
    unknown = JointNow("Lift", "prismatic", span=(0.0, 2.0), unit="m")
    assert known.line == "wheel_left 3 rad, limits -4 to 4 rad"
    assert unknown.line == "Lift prismatic position unknown, limits 0 to 2 m"


@pytest.mark.parametrize(("speed", "told"), [(1.3963, "1.39"), (24.67, "24.6"), (123.6, "123"), (0.09999, "0.0999")])
def test_a_speed_limit_is_rounded_down(speed: float, told: str) -> None:
    limit = f'<limit lower="-1" upper="1" velocity="{speed}" effort="1"/>'
    urdf = parse(f'<robot name="r"><link name="base_link"/>{joint("wrist", "revolute", limit=limit)}</robot>')
    assert lines(urdf, {"wrist": 0.0}) == [f"wrist 0 rad, limits -1 to 1 rad, at most {told} rad/s"]
