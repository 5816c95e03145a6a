"""What joints move on a robot is seen from above where they have put it; wheels and legs belong to the outline."""

from __future__ import annotations

import pytest

from ros2_mcp.model.poses import Pose, from_roll_pitch_yaw
from ros2_mcp.world.limbs import limbs_of, limbs_seen
from ros2_mcp.world.urdf import parse
from ros2_mcp_demo.arm.description import BY_NAME, description, tool_point

AT = {"shoulder_pan_joint": 0.6, "shoulder_lift_joint": 1.0, "wrist_2_joint": 1.0, "gripper_joint": 0.03}
URDF = parse(description())
ROVER = """<robot name="rover"><link name="base_link"/><link name="wheel"/><link name="camera"/>
<joint name="axle" type="continuous"><parent link="base_link"/><child link="wheel"/><axis xyz="0 1 0"/></joint>
<joint name="mount" type="fixed"><parent link="base_link"/><child link="camera"/></joint></robot>"""
MESHES = """<robot name="arm"><link name="base_link"/>
<link name="upper"><visual><geometry><mesh filename="upper.stl"/></geometry></visual></link>
<joint name="shoulder" type="revolute"><parent link="base_link"/><child link="upper"/><origin xyz="0.3 0 0.1"/>
<axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint></robot>"""


def place(link: str) -> Pose | None:
    mount = URDF.mount(link, "world", AT)
    return Pose(mount.xyz, from_roll_pitch_yaw(*mount.rpy)) if mount else None


def test_an_arm_is_seen_from_its_base_to_its_fingers() -> None:
    limbs = limbs_of(URDF, "base_link")
    names = [limb.link for limb in limbs]
    assert {joint.child for joint in BY_NAME.values()} | {"right_finger", "camera_link"} == set(names)
    seen = limbs_seen(limbs, place)
    assert len(seen) == len(names)
    assert [limb.top_m for limb in seen] == sorted(limb.top_m for limb in seen)
    x, y, _ = tool_point(AT)  # that is the tip of the tool's tube, in which its fingers begin
    corners = [corner for limb in seen for corner in limb.outline]
    assert min(abs(cx - x) + abs(cy - y) for cx, cy in corners) < 0.06
    ends = {limb.bone[1]: limb.is_jointed for limb in seen if limb.bone}
    for link, jointed in (("forearm_link", True), ("tool_link", True), ("camera_link", False)):
        pose = place(link)
        assert pose and ends[pose.translation[:2]] is jointed


def test_wheels_and_what_is_fixed_to_the_body_are_no_limbs() -> None:
    assert limbs_of(parse(ROVER), "base_link") == []
    assert limbs_of(parse(ROVER), "chassis") == ()


def test_a_link_of_meshes_is_a_line_from_the_link_that_holds_it() -> None:
    [limb] = limbs_of(parse(MESHES), "base_link")
    places = {"base_link": Pose((1.0, 0.0, 0.0)), "upper": Pose((1.3, 0.0, 0.1))}
    [seen] = limbs_seen([limb], places.get)
    assert seen.outline == () and seen.bone == ((1.0, 0.0), (1.3, 0.0))
    assert limbs_seen([limb], lambda _: None) == []
    [alone] = limbs_seen([limb], {"upper": places["upper"]}.get)
    assert alone.bone is None


def test_a_box_that_is_turned_is_seen_turned() -> None:
    [finger] = [limb for limb in limbs_of(URDF, "base_link") if limb.link == "right_finger"]
    [seen] = limbs_seen([finger], {"right_finger": Pose((0, 0, 0), from_roll_pitch_yaw(0, 1.5707963, 0))}.get)
    assert max(x for x, _ in seen.outline) == pytest.approx(0.08, abs=1e-6)  # it lies: its length is along x
