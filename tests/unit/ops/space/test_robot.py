"""The robot in brief out of what was recorded of it: right, and never more than four kilobytes."""

from __future__ import annotations

import json
import math
from typing import Any, get_args

import pytest

from ros2_mcp.model.graph import TopicEndpoints
from ros2_mcp.model.qos import Endpoint, QoS
from ros2_mcp.ops.results.results import as_json
from ros2_mcp.ops.results.text import as_text
from ros2_mcp.ops.sources.source import GraphSnapshot
from ros2_mcp.ops.space.body import MountInWords, mounted
from ros2_mcp.ops.space.brief import MOST_BYTES, Part, RobotInBrief
from ros2_mcp.ops.space.controllers import Controller, controllers_of, idle_movers
from ros2_mcp.ops.space.robot import in_brief
from ros2_mcp.ops.space.stacks import idle_servers, with_active
from ros2_mcp.robot import Robot
from ros2_mcp.world.transforms import FrameTree
from ros2_mcp.world.urdf import parse
from support.made_windows import START_NS, Make, Recorded, Window

SECOND = 1_000_000_000
TF = "tf2_msgs/msg/TFMessage"
WHEEL = '<link name="{0}"><collision><geometry><cylinder radius="0.1" length="0.04"/></geometry></collision></link>'
TURN = (
    '<joint name="{0}_joint" type="continuous"><parent link="base_link"/><child link="{0}"/>'
    '<origin xyz="0 {1} 0" rpy="-1.5708 0 0"/></joint>'
)
BASE = (
    '<link name="base_link"><collision><geometry><box size="0.6 0.4 0.2"/></geometry></collision></link>'
    '<link name="laser"/><joint name="mount" type="fixed"><parent link="base_link"/><child link="laser"/>'
    '<origin xyz="0.2 0 0.3" rpy="0 0 3.14159265"/></joint>'
)
CART = f"""<robot name="cart">{BASE}{"".join(WHEEL.format(name) for name in ("left_wheel", "right_wheel"))}
{TURN.format("left_wheel", 0.2)}{TURN.format("right_wheel", -0.2)}</robot>"""

IN_LASER = "in laser at 0.2 0 0.3 yaw 180° (by URDF, not TF)"
JOINTS = "/joint_states JointState"
"""Whose rate is not known of one message."""


def stamp(at_s: float) -> dict[str, int]:
    sec, nanosec = divmod(START_NS + round(at_s * SECOND), SECOND)
    return {"sec": sec, "nanosec": nanosec}


def windows(window: Make, urdf: str) -> list[Window]:
    def tf(parent: str, child: str, at_s: float, x: float) -> dict[str, Any]:
        header = {"frame_id": parent, "stamp": stamp(at_s)}
        return {
            "header": header,
            "child_frame_id": child,
            "transform": {"translation": {"x": x}, "rotation": {"w": 1.0}},
        }

    ticks = [number / 10 for number in range(51)]
    scan = {"angle_min": -3.1416, "angle_max": 3.1416, "range_min": 0.1, "range_max": 12.0}
    joints = {"name": ["left_wheel_joint", "right_wheel_joint"], "position": [1.5, -0.25]}
    moving = [(at, {"transforms": [tf("map", "odom", at, 1), tf("odom", "base_link", at, at)]}) for at in ticks]
    return [
        window("/tf", TF, moving),
        window("/robot_description", "std_msgs/msg/String", [(0.0, {"data": urdf})]),
        window("/scan", "sensor_msgs/msg/LaserScan",
               [(at, {"header": {"frame_id": "laser", "stamp": stamp(at)}, **scan}) for at in ticks]),
        window("/joint_states", "sensor_msgs/msg/JointState", [(4.9, joints)]),
    ]  # fmt: skip


def source(made: list[Window], *nodes: str, driven: bool = True) -> Recorded:
    node = Endpoint("/driver", "", "", "", QoS())
    topics = {one.topic: TopicEndpoints(one.topic, [Endpoint("/driver", one.type, "", "", QoS())], []) for one in made}
    if driven:
        listens = Endpoint("/base", "geometry_msgs/msg/Twist", "", "", QoS())
        topics["/cmd_vel"] = TopicEndpoints("/cmd_vel", [], [listens])
    return Recorded(made, GraphSnapshot(topics, [node.node, "/base", *nodes], {}))


def size_of(found: RobotInBrief) -> int:
    return len(json.dumps(as_json(found), ensure_ascii=False, separators=(",", ":")).encode())


async def test_everything_is_told_of_a_cart_with_a_laser(window: Make, robot: Robot) -> None:
    found = await in_brief(robot, source(windows(window, CART)))
    assert (found.name, found.kind, found.base_frame) == ("cart", "differential drive base, 2 wheels", "base_link")
    assert found.footprint.startswith("0.60 × 0.44 m, centred")
    assert found.command_inputs == ["/cmd_vel Twist → /base"]
    assert found.sensors == [f"/scan LaserScan 10 Hz {IN_LASER}, 0.1 to 12 m over 360°"]
    assert found.state_topics == [JOINTS]
    assert found.joints[0] == "left_wheel_joint continuous 1.5 rad"
    assert found.place == "In map at x 6.00 y 0.00 m, yaw 0° (TF, localised)."
    assert found.frames == "map → odom → base_link; 3 frames in total"
    assert found.unhealthy == []
    assert "differential drive" in found.summary() and "Nothing unhealthy" in found.summary()


async def test_what_is_missing_is_said(window: Make, robot: Robot) -> None:
    made = [one for one in windows(window, CART) if one.topic not in ("/joint_states", "/robot_description")]
    found = await in_brief(robot, source(made))
    assert (found.kind, found.footprint, found.joints) == ("base driven by velocities", "unknown", [])
    assert any("No description (URDF) was found" in line for line in found.unhealthy)
    described = [one for one in windows(window, CART) if one.topic != "/joint_states"]
    found = await in_brief(robot, source(described))
    assert "Nothing reports the position of left_wheel_joint, right_wheel_joint." in found.unhealthy
    nothing = await in_brief(robot, source([]))
    assert nothing.kind == "base driven by velocities" and "unknown" in nothing.place


async def test_one_sensor_that_cannot_be_read_takes_nothing_else_away(window: Make, robot: Robot) -> None:
    header = {"frame_id": "laser", "stamp": stamp(4.9)}
    ultrasound = {"header": header, "min_range": 0.05, "max_range": 4.0, "range": 1.0}
    made = [
        *windows(window, CART),
        window("/sonar", "sensor_msgs/msg/Range", [(at / 10, ultrasound) for at in range(49)]),
        window("/battery", "sensor_msgs/msg/BatteryState", [(4.0, {"header": header, "percentage": 72.0})]),
        window("/odom", "nav_msgs/msg/Odometry", [(4.0, {"header": header})]),
        window("/wrench", "geometry_msgs/msg/WrenchStamped", [(at / 10, {"header": header}) for at in range(49)]),
    ]
    found = await in_brief(robot, source(made))
    lines = "\n".join(found.sensors)
    assert f"/sonar Range 10 Hz {IN_LASER}, 0.05 to 4 m" in lines
    assert "/battery BatteryState 72%" in lines and "/wrench WrenchStamped 10 Hz" in lines
    assert found.unhealthy == [] and found.kind.startswith("differential")


@pytest.mark.parametrize(
    ("told", "shown"),
    [({"percentage": 0.0, "voltage": 12.4}, ""), ({"percentage": 0.0, "capacity": 5.0}, " 0%"), ({}, "")],
)
async def test_a_battery_whose_percentage_was_never_filled_in_is_not_at_zero(
    window: Make, robot: Robot, told: dict[str, float], shown: str
) -> None:
    battery = window("/battery", "sensor_msgs/msg/BatteryState", [(4.0, told)])
    found = await in_brief(robot, source([*windows(window, CART), battery]))
    assert ("/battery BatteryState 0%" in "\n".join(found.sensors)) == bool(shown)
    assert any("The battery is at" in line for line in found.unhealthy) == bool(shown)


async def test_what_a_joint_carries_sits_where_that_joint_is_or_nowhere(window: Make, robot: Robot) -> None:
    """Without its /tf the description says where it sits; that a joint which nobody tells is at 0 would be a guess."""
    pan = BASE.replace('type="fixed"', 'type="revolute"').replace("</joint>", '<axis xyz="0 0 1"/></joint>')
    made = windows(window, f'<robot name="cart">{pan}</robot>')
    found = await in_brief(robot, source(made))
    unknown = "in laser (mount unknown: mount moves it)"
    assert found.sensors == [f"/scan LaserScan 10 Hz {unknown}, 0.1 to 12 m over 360°"]
    told = window(
        "/joint_states", "sensor_msgs/msg/JointState", [(4.9, {"name": ["mount"], "position": [-math.pi / 2]})]
    )
    found = await in_brief(robot, source([*made[:-1], told]))
    mount = "in laser at 0.2 0 0.3 yaw 90° moving with mount (by URDF, not TF)"
    assert found.sensors == [f"/scan LaserScan 10 Hz {mount}, 0.1 to 12 m over 360°"]


async def test_joints_that_are_told_in_turns_are_all_told(window: Make, robot: Robot) -> None:
    made = [one for one in windows(window, CART) if one.topic != "/joint_states"]
    names = ("left_wheel_joint", "right_wheel_joint")
    turns = [(4.5 + turn / 30, {"name": [names[turn % 2]], "position": [float(turn % 2)]}) for turn in range(8)]
    found = await in_brief(robot, source([*made, window("/joint_states", "sensor_msgs/msg/JointState", turns)]))
    assert [line.partition(" rad")[0] for line in found.joints] == [
        "left_wheel_joint continuous 0",
        "right_wheel_joint continuous 1",
    ]
    assert found.unhealthy == []


def test_a_camera_s_tilt_is_told_and_a_steep_one_has_no_direction() -> None:
    urdf = parse(
        """<robot name="r"><link name="base_link"/>
        <link name="a_optical"/><joint name="a" type="fixed"><parent link="base_link"/><child link="a_optical"/>
        <origin xyz="0 0 1" rpy="-1.9198622 0 -1.5707963"/></joint>
        <link name="b_optical"/><joint name="b" type="fixed"><parent link="base_link"/><child link="b_optical"/>
        <origin rpy="3.1 0 0"/></joint></robot>"""
    )
    told = [mounted(urdf, FrameTree(), "base_link", name, {}) for name in ("a_optical", "b_optical")]
    assert told == [
        MountInWords("0 0 1 20° down", " (by URDF, not TF)"),
        MountInWords("0 0 0 straight down", " (by URDF, not TF)"),
    ]


def test_of_a_camera_in_a_frame_that_is_not_called_optical_it_is_told_where_its_z_points() -> None:
    def at(rpy: str) -> str:
        urdf = parse(
            f"""<robot name="r"><link name="base_link"/><link name="eye"/><joint name="a" type="fixed">
            <parent link="base_link"/><child link="eye"/><origin xyz="0 0 1" rpy="{rpy}"/></joint></robot>"""
        )
        return mounted(urdf, FrameTree(), "base_link", "eye", {}, is_camera=True).at

    assert at("-1.5707963 0 -1.5707963") == "0 0 1 z to the front"
    assert at("-1.9198622 0 0") == "0 0 1 z to yaw 90° 20° down"
    assert at("3.1415927 0 0") == "0 0 1 z to straight down"
    assert at("0 0.2 0.5235988") == "0 0 1 pitch 11° yaw 30°", "a frame with z up is that of the camera's body"


async def test_a_sensor_in_a_frame_that_nobody_tells_is_unhealthy(window: Make, robot: Robot) -> None:
    header = {"frame_id": "velodyne", "stamp": stamp(4.9)}
    cloud = window("/points", "sensor_msgs/msg/PointCloud2", [(at / 10, {"header": header}) for at in range(49)])
    found = await in_brief(robot, source([*windows(window, CART), cloud]))
    assert "/points PointCloud2 10 Hz in velodyne (mount unknown)" in found.sensors
    assert found.unhealthy == ["Not in TF: velodyne."]


async def test_what_a_robot_tells_of_itself_has_its_value_and_one_that_is_a_fault_is_unhealthy(
    window: Make, robot: Robot
) -> None:
    made = [
        *windows(window, CART),
        window("/mode", "std_msgs/msg/String", [(1.0, {"data": "parking"}), (4.0, {"data": "navigation"})]),
        window("/is_homed", "std_msgs/msg/Bool", [(4.0, {"data": True})]),
        window("/left_motor", "std_msgs/msg/Float32", []),
    ]
    found = await in_brief(robot, source(made))
    told = ["/is_homed Bool true", "/left_motor Float32", "/mode String «navigation»"]
    assert found.state_topics == [JOINTS, *told] and found.unhealthy == []


async def test_how_wide_a_camera_and_an_ultrasound_see_is_told(window: Make, robot: Robot) -> None:
    header = {"frame_id": "laser", "stamp": stamp(4.9)}
    camera = {"header": header, "width": 640, "height": 480, "k": [320.0, 0, 0, 0, 320.0, 0, 0, 0, 1.0]}
    sonar = {"header": header, "min_range": 0.25, "max_range": 2.55, "field_of_view": math.radians(30), "range": 1.0}
    made = [
        *windows(window, CART),
        window("/camera/image_raw", "sensor_msgs/msg/Image", [(at / 10, {"header": header}) for at in range(49)]),
        window("/camera/camera_info", "sensor_msgs/msg/CameraInfo", [(4.9, camera)]),
        window("/sonar", "sensor_msgs/msg/Range", [(at / 10, sonar) for at in range(49)]),
    ]
    lines = (await in_brief(robot, source(made))).sensors
    assert f"/camera/image_raw Image 10 Hz 90° wide {IN_LASER}" in lines
    assert f"/sonar Range 10 Hz {IN_LASER}, 0.25 to 2.55 m over 30°" in lines


async def test_of_joints_only_what_is_told_as_their_states_is_where_they_are(window: Make, robot: Robot) -> None:
    """Stretch tells limits of its joints as a JointState, too."""
    limits = {"name": ["left_wheel_joint", "right_wheel_joint"], "position": [-9.0, -9.0]}
    made = windows(window, CART)
    found = await in_brief(
        robot, source([*made, window("/joint_limits", "sensor_msgs/msg/JointState", [(4.95, limits)])])
    )
    assert found.joints == ["left_wheel_joint continuous 1.5 rad", "right_wheel_joint continuous -0.25 rad"]
    alone = [one for one in made if one.topic != "/joint_states"]
    told = window("/arm/measured", "sensor_msgs/msg/JointState", [(4.9, limits)])
    assert (await in_brief(robot, source([*alone, told]))).joints[0] == "left_wheel_joint continuous -9 rad"


async def test_a_sensor_that_is_mounted_upside_down_says_so(window: Make, robot: Robot) -> None:
    found = await in_brief(robot, source(windows(window, CART.replace("0 0 3.14159265", "3.14159265 0 0"))))
    assert found.sensors[0].startswith(
        "/scan LaserScan 10 Hz in laser at 0.2 0 0.3 roll 180° (by URDF, not TF), 0.1 to 12 m over 360°"
    ), found.sensors


async def test_an_outline_that_only_the_costmap_tells_is_told_in_the_frame_of_the_base(
    window: Make, robot: Robot
) -> None:
    around = [(6.0 + 0.3 * math.cos(turn / 8 * math.pi), 0.3 * math.sin(turn / 8 * math.pi)) for turn in range(16)]
    outline = {
        "header": {"frame_id": "map", "stamp": stamp(4.9)},
        "polygon": {"points": [{"x": x, "y": y} for x, y in around]},
    }
    footprint = window("/local_costmap/published_footprint", "geometry_msgs/msg/PolygonStamped", [(4.9, outline)])
    bare = '<robot name="bare"><link name="base_link"/></robot>'
    found = await in_brief(robot, source([*windows(window, bare), footprint]))
    assert found.footprint == "radius 0.30 m (costmap)"


async def test_an_arm_that_its_description_fixes_in_the_world_is_there(window: Make, robot: Robot) -> None:
    urdf = (
        '<robot name="arm"><link name="world"/><link name="base_link"/><joint name="fix" type="fixed">'
        '<parent link="world"/><child link="base_link"/><origin xyz="0.5 0 1" rpy="0 0 1.5708"/></joint></robot>'
    )
    described = window("/robot_description", "std_msgs/msg/String", [(0.0, {"data": urdf})])
    found = await in_brief(robot, source([described]))
    assert found.place == "In world at x 0.50 y 0.00 z 1.00 m, yaw 90° (URDF, static)."
    assert (found.frames, found.unhealthy) == ("none", [])
    free = urdf.replace('type="fixed"', 'type="floating"')
    described = window("/robot_description", "std_msgs/msg/String", [(0.0, {"data": free})])
    assert "unknown" in (await in_brief(robot, source([described]))).place


async def test_a_base_with_a_name_of_its_own_is_told_in_its_chain_of_frames(window: Make, robot: Robot) -> None:
    """As Unitree's quadrupeds have it: the root of the description is called `base`."""
    urdf = '<robot name="dog"><link name="base"/></robot>'
    header = {"frame_id": "odom", "stamp": stamp(4.9)}
    told = {"header": header, "child_frame_id": "base", "transform": {"rotation": {"w": 1.0}}}
    made = [
        window("/robot_description", "std_msgs/msg/String", [(0.0, {"data": urdf})]),
        window("/tf", TF, [(4.9, {"transforms": [told]})]),
    ]
    found = await in_brief(robot, source(made))
    assert (found.base_frame, found.frames) == ("base", "odom → base; 2 frames in total")


async def test_frames_that_did_not_come_are_not_said_to_be_none(window: Make, robot: Robot) -> None:
    made = [one for one in windows(window, CART) if one.topic != "/tf"]
    found = await in_brief(robot, source([*made, window("/tf", TF, [])]))
    assert (found.frames, found.place) == ("not read", "The robot's pose was not read in time."), found


async def test_a_localiser_that_tells_no_place_is_told(window: Make, robot: Robot) -> None:
    made = [one for one in windows(window, CART) if one.topic != "/tf"]
    header = {"frame_id": "odom", "stamp": stamp(4.9)}
    turn = {"translation": {"x": 0.0}, "rotation": {"w": 1.0}}
    tf = {"transforms": [{"header": header, "child_frame_id": "base_link", "transform": turn}]}
    found = await in_brief(robot, source([*made, window("/tf", TF, [(4.9, tf)])], "/amcl"))
    assert any("Not localised: /amcl runs" in line for line in found.unhealthy), found.unhealthy


ARM = "/arm_controller/follow_joint_trajectory"


def controlled(*nodes: str) -> GraphSnapshot:
    kind = "control_msgs/action/FollowJointTrajectory_FeedbackMessage"
    status = TopicEndpoints(f"{ARM}/_action/status", [Endpoint("/arm_controller", kind, "", "", QoS())], [])
    return GraphSnapshot({status.topic: status}, list(nodes), {})


def test_controllers_are_told_movers_first_and_the_inactive_as_such() -> None:
    graph = controlled("/arm_controller", "/diff_drive_controller")
    rows = [
        {"name": "joint_state_broadcaster", "type": "x/JointStateBroadcaster", "state": "active"},
        {"name": "forward", "type": "velocity_controllers/JointGroupVelocityController", "state": "inactive"},
        {"name": "arm_controller", "type": "x/JointTrajectoryController", "state": "active"},
    ]
    told = controllers_of(graph, {"/controller_manager": rows}, is_controlled=True)
    assert [one.line for one in told] == [
        "/arm_controller JointTrajectoryController",
        "/forward JointGroupVelocityController is inactive",
        "/joint_state_broadcaster",
    ]


def test_without_a_manager_s_answer_a_name_alone_makes_no_controller() -> None:
    assert controllers_of(controlled("/arm_controller", "/diff_drive_controller"), {}, is_controlled=False) == [
        Controller("/arm_controller")
    ]
    assert controllers_of(controlled("/driver"), {}, is_controlled=False) == []  # an action in the driver's namespace


def test_that_all_controllers_that_move_joints_are_idle_is_told() -> None:
    graph = controlled("/arm_controller")

    def states(arm: str, other: str) -> list[str]:
        rows = [{"name": "arm_controller", "state": arm}, {"name": "joint_state_broadcaster", "state": other}]
        return idle_movers(graph, {"/controller_manager": rows})

    assert states("inactive", "active") == ["No controller that moves joints is active."]
    assert states("active", "inactive") == [] == idle_movers(graph, {}) == idle_movers(GraphSnapshot({}, [], {}), {})


async def test_of_a_mobile_manipulator_the_joints_of_the_arm_are_told_before_its_wheels(
    window: Make, robot: Robot
) -> None:
    """As in many descriptions the wheels come first, then a lift and a head, and the arm last."""
    arm = [f"{name}_joint" for name in ("shoulder_pan", "shoulder_lift", "upperarm_roll", "elbow_flex")]
    arm += [f"{name}_joint" for name in ("forearm_roll", "wrist_flex", "wrist_roll")]
    links, joints, above = list[str](), list[str](), "torso"
    others = [
        ("torso", "base_link", "prismatic"),
        ("head_pan", "torso", "revolute"),
        ("head_tilt", "head_pan", "revolute"),
    ]
    for name in arm:
        others.append((name.removesuffix("_joint"), above, "revolute"))
        above = name.removesuffix("_joint")
    others += [("l_gripper_finger", above, "prismatic"), ("r_gripper_finger", above, "prismatic")]
    for child, parent, kind in others:
        links.append(f'<link name="{child}"/>')
        joints.append(
            f'<joint name="{child}_joint" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            '<limit lower="-1.5" upper="1.5" velocity="1.25" effort="10"/></joint>'
        )
    urdf = CART.replace("</robot>", "".join([*links, *joints, "</robot>"]))
    header = {"frame_id": "laser", "stamp": stamp(4.9)}
    sensors = [
        window(
            f"/head_camera/{name}/points",
            "sensor_msgs/msg/PointCloud2",
            [(at / 10, {"header": header}) for at in range(49)],
        )
        for name in ("depth_downsample", "depth_registered", "rgb_registered", "filtered")
    ]
    found = await in_brief(robot, source([*windows(window, urdf), *sensors]))
    assert [line.split()[0] for line in found.joints[:7]] == arm
    assert found.kind == "differential drive base, 2 wheels with an arm of 7 joints and a gripper"
    assert size_of(found) <= MOST_BYTES


def chain_of(count: int, name: str = "snake") -> str:
    """A robot with so many joints in a row."""
    links = "".join(
        f'<link name="link_{n}"/><joint name="a_long_name_of_the_joint_{n}" type="revolute">'
        f'<parent link="{f"link_{n - 1}" if n else "base_link"}"/>'
        f'<child link="link_{n}"/><limit lower="-1" upper="{1 + n / 10}" velocity="1" effort="1"/></joint>'
        for n in range(count)
    )
    return f'<robot name="{name}">{BASE}{links}</robot>'


def bytes_of(found: RobotInBrief) -> int:
    """Of its JSON or its text, whichever has more."""
    return max(size_of(found), len(as_text(found).encode()))


@pytest.mark.parametrize("count", [3, 200])
async def test_it_is_never_more_than_four_kilobytes_and_what_is_left_out_is_counted(
    window: Make, robot: Robot, count: int
) -> None:
    made = source(windows(window, chain_of(count, "x" * 2000)))
    found = await in_brief(robot, made)
    assert bytes_of(found) <= MOST_BYTES
    whole = await in_brief(robot, made, whole=True)
    assert (len(whole.joints), whole.omitted) == (count + len(("the left wheel", "the right wheel")), 0)
    assert whole.joints[count - 1] == (
        f"a_long_name_of_the_joint_{count - 1} position unknown, "
        f"limits -1 to {1 + (count - 1) / 10:g} rad, at most 1 rad/s"
    )
    if count == 3:
        assert (found.omitted, found.joints) == (0, whole.joints)
        return
    *first, account = found.joints
    assert len(first) > 10 and first == whole.joints[: len(first)]
    assert account == f'{len(whole.joints) - len(first)} more: part="joints" shows all.'
    assert found.omitted == len(whole.joints) - len(first)
    assert str(found.omitted) in found.summary()


async def test_one_part_is_told_in_full_beside_what_is_unhealthy_and_the_others_are_counted(
    window: Make, robot: Robot
) -> None:
    made = source(windows(window, chain_of(200)))
    whole, found = await in_brief(robot, made, whole=True), await in_brief(robot, made, part="joints")
    assert (found.joints, found.unhealthy) == (whole.joints, whole.unhealthy) and len(found.joints) == 202
    assert found.sensors == ['1: part="sensors" shows all.'] and found.controllers == []
    assert found.omitted == len([*whole.sensors, *whole.command_inputs, *whole.state_topics])


@pytest.mark.parametrize("part", get_args(Part)[1:])
async def test_every_part_has_everything_with_its_name(window: Make, robot: Robot, part: Part) -> None:
    made = source(windows(window, chain_of(100)))
    whole, found = await in_brief(robot, made, whole=True), await in_brief(robot, made, part=part)
    assert getattr(found, part) == getattr(whole, part)


async def test_what_is_unhealthy_stands_in_the_first_kilobyte(window: Make, robot: Robot) -> None:
    header = {"frame_id": "velodyne", "stamp": stamp(4.9)}
    cloud = window("/points", "sensor_msgs/msg/PointCloud2", [(at / 10, {"header": header}) for at in range(49)])
    services = {f"/driver/order_{n}": ["std_srvs/srv/Trigger"] for n in range(300)}
    graph = await source([*windows(window, chain_of(100)), cloud]).graph()
    found = await in_brief(
        robot, Recorded([*windows(window, chain_of(100)), cloud], GraphSnapshot(graph.topics, graph.nodes, services))
    )
    assert as_text(found).index("Not in TF: velodyne.") < 1000
    assert bytes_of(found) <= MOST_BYTES


async def test_what_is_only_named_is_left_out_before_what_is_described(window: Make, robot: Robot) -> None:
    """Services first: a robot's driver has dozens."""
    made = windows(window, CART)
    live = source([*made, *(window(f"/said_{n}", "std_msgs/msg/Bool", []) for n in range(30))])
    services = {f"/driver/order_{n}": ["std_srvs/srv/Trigger"] for n in range(300)}
    graph = await live.graph()
    found = await in_brief(robot, Recorded([*made], GraphSnapshot(graph.topics, graph.nodes, services)))
    assert found.joints == ["left_wheel_joint continuous 1.5 rad", "right_wheel_joint continuous -0.25 rad"]
    assert "/scan LaserScan" in found.sensors[0] and len(found.state_topics) == 31
    assert found.command_services[-1] == f'{found.omitted} more: part="command_services" shows all.'
    assert bytes_of(found) <= MOST_BYTES


def test_servers_of_nav2_that_are_not_active_are_unhealthy_and_others_are_not_mentioned() -> None:
    assert idle_servers("3 of 8 active") == ["Of Nav2's servers, 3 of 8 active."]
    assert idle_servers("8 of 8 active") == idle_servers("") == []
    assert with_active(["Nav2"], "8 of 8 active") == ["Nav2: 8 of 8 active"]
