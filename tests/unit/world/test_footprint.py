"""The outline of a robot out of its description."""

from __future__ import annotations

import math

import pytest

from ros2_mcp.ops.space.body import footprint_in_words
from ros2_mcp.world.footprint import Reach, outline, reach, unmeasured
from ros2_mcp.world.transforms import FrameTree
from ros2_mcp.world.urdf import parse
from ros2_mcp_demo.base import RADIUS
from ros2_mcp_demo.nodes.robot_state_publisher import description

BOX = '<collision><origin xyz="{at}" rpy="{turned}"/><geometry><box size="{size}"/></geometry></collision>'
MESH = '<visual><geometry><mesh filename="a.stl"/></geometry></visual>'


def box(size: str, at: str = "0 0 0", turned: str = "0 0 0") -> str:
    return BOX.format(size=size, at=at, turned=turned)


def joint(child: str, kind: str = "fixed", at: str = "0 0 0", parent: str = "base_link") -> str:
    return (
        f'<joint name="{child}_joint" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{at}"/><axis xyz="0 1 0"/></joint>'
    )


def reached(*parts: str, base: str = "base_link", **links: str) -> Reach | None:
    text = "".join(f'<link name="{name}">{inside}</link>' for name, inside in links.items())
    return reach(outline(parse(f'<robot name="made">{text}{"".join(parts)}</robot>'), base))


def approx(front: float, rear: float, left: float, right: float, radius: float) -> Reach:
    return Reach(*(pytest.approx(one, abs=1e-6) for one in (front, rear, left, right, radius)))


def test_a_box_is_as_long_as_it_says() -> None:
    assert reached(base_link=box("0.6 0.4 0.2")) == approx(0.3, 0.3, 0.2, 0.2, math.hypot(0.3, 0.2))


def test_a_box_before_the_origin_reaches_further_ahead() -> None:
    assert reached(base_link=box("0.6 0.4 0.2", at="0.1 0 0")) == approx(0.4, 0.2, 0.2, 0.2, math.hypot(0.4, 0.2))


def test_a_turned_box_is_turned() -> None:
    assert reached(base_link=box("0.6 0.4 0.2", turned=f"0 0 {math.pi / 2}")) == approx(
        0.2, 0.2, 0.3, 0.3, math.hypot(0.3, 0.2)
    )


def test_what_is_fixed_to_the_base_belongs_to_it_and_its_wheels_do() -> None:
    found = reached(
        joint("bumper", at="0.5 0 0"),
        joint("wheel", "continuous", at="0 0.3 0"),
        base_link=box("0.4 0.4 0.2"),
        bumper=box("0.1 0.1 0.1"),
        wheel='<collision><geometry><sphere radius="0.05"/></geometry></collision>',
    )
    assert found == approx(0.55, 0.2, 0.35, 0.2, math.hypot(0.55, 0.05))


def test_an_arm_that_moves_does_not_belong_to_the_outline() -> None:
    found = reached(joint("arm", "revolute", at="0.2 0 0"), base_link=box("0.4 0.4 0.2"), arm=box("2 0.1 0.1"))
    assert found == approx(0.2, 0.2, 0.2, 0.2, math.hypot(0.2, 0.2))


def test_legs_belong_to_the_outline_of_what_walks_on_them() -> None:
    """As a small quadruped: a trunk of 0.38 x 0.09 m, feet at 0.19 and 0.13 m, joints at 0."""
    links, joints = {"base_link": box("0.38 0.09 0.1")}, list[str]()
    for leg, x, y in (("FL", 0.19, 1), ("FR", 0.19, -1), ("RL", -0.19, 1), ("RR", -0.19, -1)):
        joints += [
            joint(f"{leg}_hip", "revolute", f"{x} {0.05 * y} 0"),
            joint(f"{leg}_thigh", "revolute", f"0 {0.08 * y} 0", f"{leg}_hip"),
            joint(f"{leg}_calf", "revolute", "0 0 -0.21", f"{leg}_thigh"),
            joint(f"{leg}_foot", "fixed", "0 0 -0.21", f"{leg}_calf"),
        ]
        links |= {f"{leg}_hip": "", f"{leg}_thigh": box("0.03 0.03 0.2", "0 0 -0.1"), f"{leg}_calf": MESH}
        links[f"{leg}_foot"] = '<collision><geometry><sphere radius="0.02"/></geometry></collision>'
    assert reached(*joints, **links) == approx(0.21, 0.21, 0.15, 0.15, math.hypot(0.205, 0.145))


def test_a_base_above_a_footprint_sees_the_outline_from_its_own_origin() -> None:
    found = reached(
        joint("base_link", at="0.1 0 0.2", parent="base_footprint"), base_footprint="", base_link=box("0.4 0.4 0.2")
    )
    assert found == approx(0.2, 0.2, 0.2, 0.2, math.hypot(0.2, 0.2))


def test_a_rotor_reaches_as_far_as_it_sweeps() -> None:
    upright = joint("rotor", "continuous", at="0.1 0 0.1").replace("0 1 0", "0 0 1")
    found = reached(upright, base_link=box("0.2 0.2 0.1"), rotor=box("0.3 0.02 0.01"))
    radius = math.hypot(0.15, 0.01)
    assert found == approx(0.1 + radius, 0.1, radius, radius, 0.1 + radius)
    aside = reached(joint("rotor", "continuous"), base_link=box("0.2 0.1 0.1"), rotor=box("0.3 0.02 0.01"))
    radius = math.hypot(0.15, 0.005)
    assert aside == approx(radius, radius, 0.05, 0.05, radius)


def test_shapes_of_collision_count_before_those_that_are_seen() -> None:
    seen = '<visual><geometry><box size="9 9 1"/></geometry></visual>'
    assert reached(base_link=seen + box("0.4 0.4 0.2")) == approx(0.2, 0.2, 0.2, 0.2, math.hypot(0.2, 0.2))


@pytest.mark.parametrize(
    "inside", ["", '<visual><geometry><mesh filename="a.stl"/></geometry></visual>', box("600 400 2")]
)
def test_without_a_size_there_is_no_outline(inside: str) -> None:
    assert reached(base_link=inside) is None
    assert reached(base_link=box("1 1 1"), base="other") is None


def test_the_simulated_rover_is_as_round_as_it_is() -> None:
    found = reach(outline(parse(description()), "base_link"))
    assert found is not None and found.radius_m == pytest.approx(RADIUS, rel=0.02)


def test_a_steered_wheel_belongs_to_the_outline() -> None:
    found = reached(
        joint("hinge", at="0.3 0.1 0"),
        joint("front_wheel", "revolute", parent="hinge"),
        base_link=box("0.4 0.4 0.2"),
        hinge="",
        front_wheel=box("0.2 0.1 0.1"),
    )
    assert found == approx(0.4, 0.2, 0.2, 0.2, math.hypot(0.4, 0.15))


def test_a_part_of_which_only_a_mesh_tells_the_shape_is_told() -> None:
    links = f'<link name="base_link">{MESH}</link><link name="wheel">{box("0.1 0.1 0.1")}</link>'
    urdf = parse(f'<robot name="made">{links}{joint("wheel", "continuous")}</robot>')
    assert unmeasured(urdf, "base_link") == ["base_link"]
    assert "at least 0.10 × 0.10 m" in footprint_in_words(urdf, FrameTree(), "base_link", (), "")
    bare = parse(f'<robot name="made"><link name="base_link">{MESH}</link></robot>')
    assert footprint_in_words(bare, FrameTree(), "base_link", (), "") == "unknown: base_link has only a mesh"
