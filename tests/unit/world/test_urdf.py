"""URDFs as they are found: limits, mounts, shapes, and what is wrong with them in words."""

from __future__ import annotations

import math

import pytest

from ros2_mcp.model.errors import BadData
from ros2_mcp.ops.space.joints import joints_now
from ros2_mcp.world.urdf import Limits, Mimic, Mount, parse

ARM = """<?xml version="1.0"?>
<robot name="two_links" xmlns:xacro="http://ros.org/wiki/xacro">
  <link name="base">
    <collision><origin xyz="0 0 0.1"/><geometry><cylinder radius="0.2" length="0.3"/></geometry></collision></link>
  <link name="upper"><inertial><mass value="1.5"/></inertial>
    <visual><geometry><mesh filename="package://two/upper.stl" scale="0.001 0.001 0.001"/></geometry></visual></link>
  <link name="tip"/><link name="camera"/><link name="finger"/><link name="other_finger"/>
  <joint name="shoulder" type="revolute">
    <parent link="base"/><child link="upper"/><origin xyz="0 0 1" rpy="0 0 1.5707963267948966"/><axis xyz="0 1 0"/>
    <limit lower="-1.5" upper="2" velocity="0.8" effort="30"/>
    <safety_controller soft_lower_limit="-1.2" k_velocity="1"/>
  </joint>
  <joint name="wrist" type="continuous"><parent link="upper"/><child link="tip"/><origin xyz="0.5 0 0"/></joint>
  <joint name="mount" type="fixed">
    <parent link="tip"/><child link="camera"/><origin xyz="0.1 0 0" rpy="0 0.5 0"/></joint>
  <joint name="grip" type="prismatic">
    <parent link="tip"/><child link="finger"/><limit upper="0.04" velocity="0.1" effort="5"/></joint>
  <joint name="grip_2" type="prismatic"><parent link="tip"/><child link="other_finger"/>
    <limit upper="0.04" velocity="0.1" effort="5"/><mimic joint="grip" multiplier="-1"/></joint>
  <ros2_control name="arm" type="system">
    <joint name="shoulder"><command_interface name="position"/></joint></ros2_control>
</robot>"""


def test_joints_have_the_limits_that_hold_for_them():
    urdf = parse(ARM)
    assert urdf.joints["shoulder"].limits == Limits(-1.2, 2.0, 0.8, 30.0)
    assert urdf.joints["grip"].limits == Limits(0.0, 0.04, 0.1, 5.0)
    assert urdf.joints["wrist"].limits == Limits()
    assert (urdf.joints["grip"].unit, urdf.joints["wrist"].unit) == ("m", "rad")
    assert urdf.problems == []


@pytest.mark.parametrize("bound", ['lower="${-pi}" upper="1"', 'lower="0" upper="nan"', 'lower="" upper="1"'])
def test_limits_that_are_no_numbers_are_unknown_and_not_from_zero_to_zero(bound: str) -> None:
    text = f"""<robot name="r"><link name="a"/><link name="b"/>
    <joint name="j" type="revolute"><parent link="a"/><child link="b"/><limit {bound} velocity="1"/></joint></robot>"""
    urdf = parse(text)
    assert (urdf.joints["j"].limits.known, urdf.joints["j"].limits.velocity) == (False, 1.0)
    assert "not a number" in urdf.problems[0]
    (row,) = joints_now(urdf, {"j": 0.5}, "")
    assert row.span is None and "limits" not in row.line


def test_a_joint_that_follows_another_is_none_that_is_moved():
    urdf = parse(ARM)
    assert [joint.name for joint in urdf.moving] == ["shoulder", "wrist", "grip"]
    assert urdf.joints["grip_2"].mimic == Mimic("grip", -1.0, 0.0)
    assert urdf.controlled == {"shoulder": ["position"]}


def test_where_a_link_sits_is_told_in_every_frame_above_it():
    urdf = parse(ARM)
    assert urdf.root == "base"
    found = urdf.mount("camera")
    assert found is not None
    assert found.xyz == pytest.approx((0.0, 0.6, 1.0))
    assert found.rpy == pytest.approx((0.0, 0.5, math.pi / 2))
    assert urdf.mount("camera", "tip") == Mount((0.1, 0.0, 0.0), (0.0, 0.5, 0.0))
    assert urdf.mount("base", "camera") is None
    assert urdf.mount("nowhere") is None
    assert urdf.fixed_to("camera") == "tip"


def test_a_link_sits_where_the_joints_above_it_have_moved_it():
    urdf = parse(ARM)
    assert [joint.name for joint in urdf.moved_by("camera")] == ["wrist", "shoulder"]
    assert urdf.moved_by("camera", "tip") == []
    down = urdf.mount("camera", positions={"shoulder": math.pi / 2})
    assert down is not None and down.xyz == pytest.approx((0.0, 0.0, 0.4))
    opened = urdf.mount("other_finger", "tip", {"grip": 0.02})
    assert opened == Mount((-0.02, 0.0, 0.0))
    assert urdf.position(urdf.joints["grip_2"], {}) is None


def test_shapes_have_their_sizes_and_masses():
    urdf = parse(ARM)
    (cylinder,) = urdf.links["base"].collisions
    assert (cylinder.kind, cylinder.size, cylinder.mount.xyz) == ("cylinder", (0.2, 0.3), (0.0, 0.0, 0.1))
    (mesh,) = urdf.links["upper"].visuals
    assert (mesh.kind, mesh.mesh, mesh.size) == ("mesh", "package://two/upper.stl", (0.001, 0.001, 0.001))
    assert urdf.links["upper"].mass == 1.5


@pytest.mark.parametrize(
    "angles", [(0.3, -0.7, 2.0), (0.0, math.pi / 2, 0.4), (-3.0, 1.2, -2.9), (0.0, -math.pi / 2, 1.0)]
)
def test_angles_survive_being_told_in_another_frame(angles):
    there = Mount((1.0, 2.0, 3.0), angles)
    assert Mount().of(there).rpy == pytest.approx(angles)


def test_what_is_wrong_is_told_and_the_rest_is_read():
    urdf = parse(
        '<robot name="x"><link name="a"/><link name="b"/><link/>'
        '<joint name="j" type="revolute"><parent link="a"/><child link="b"/><origin xyz="0 zero 0"/></joint>'
        '<joint name="k" type="hinge"><parent link="a"/><child link="b"/></joint>'
        '<joint name="l" type="fixed"><parent link="a"/><child link="c"/></joint></robot>'
    )
    assert list(urdf.joints) == ["j"]
    assert urdf.problems == [
        "a link has no name",
        "xyz of «j» is «0 zero 0», not three numbers",
        "the joint «j» has no limits",
        "the joint «k» has the unknown type «hinge»",
        "the joint «l» refers to «c», which is not a link",
    ]


def test_a_tree_with_two_roots_or_a_circle_has_none():
    joint = '<joint name="{}" type="fixed"><parent link="{}"/><child link="{}"/></joint>'
    two = parse('<robot name="x"><link name="a"/><link name="b"/></robot>')
    assert two.root == "" and two.problems == ["2 links have no parent: «a», «b»"]
    circle = parse(
        '<robot name="x"><link name="a"/><link name="b"/>'
        + joint.format("j", "a", "b")
        + joint.format("k", "b", "a")
        + "</robot>"
    )
    assert circle.root == "" and circle.problems == ["every link has a parent"]
    assert circle.mount("a") is None
    assert circle.fixed_to("a") in circle.links


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("xacro: no such file", "is not valid XML"),
        ("<sdf><model/></sdf>", "begins with «sdf»"),
        ("<robot name='x'/>", "has no link"),
        ('<!DOCTYPE robot [<!ENTITY a "aaaa">]><robot name="&a;"><link name="b"/></robot>', "declares a document type"),
        ("<robot>" + " " * 10_000_001, "at most 10000000 are read"),
    ],
)
def test_what_is_no_urdf_is_refused_in_words(text, why):
    with pytest.raises(BadData, match=why):
        parse(text)
