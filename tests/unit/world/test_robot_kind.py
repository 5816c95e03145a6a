"""What kind of robot a description speaks of: descriptions built as those of public robots are."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from ros2_mcp.world.robot_kind import arms_of, kind_of, wheels_of
from ros2_mcp.world.urdf import Urdf, parse

TWIST = "geometry_msgs/msg/Twist"


def urdf(name: str, *joints: tuple[str, str, str, str], wheel: Sequence[str] = ()) -> Urdf:
    """From (joint, kind, parent, child); the children in `wheel` are cylinders."""
    links = dict.fromkeys([name for joint in joints for name in joint[2:]])
    shape = '<collision><geometry><cylinder radius="0.1" length="0.05"/></geometry></collision>'
    limit = '<limit lower="-2" upper="2" velocity="1" effort="1"/>'
    text = [f'<link name="{link}">{shape if link in wheel else ""}</link>' for link in links]
    text += [
        f'<joint name="{joint}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{limit}</joint>'
        for joint, kind, parent, child in joints
    ]
    return parse(f'<robot name="{name}">{"".join(text)}</robot>')


def wheels(*names: str, parent: str = "base_link") -> list[tuple[str, str, str, str]]:
    return [(f"{name}_joint", "continuous", parent, f"{name}_link") for name in names]


def chain(kind: str, *names: str, parent: str = "base_link") -> list[tuple[str, str, str, str]]:
    links = [parent, *(f"{name}_link" for name in names)]
    return [(name, kind, above, link) for name, above, link in zip(names, links, links[1:], strict=False)]


def legs() -> list[tuple[str, str, str, str]]:
    return [
        joint
        for leg in ("FL", "FR", "RL", "RR")
        for joint in chain("revolute", f"{leg}_hip_joint", f"{leg}_thigh_joint", f"{leg}_calf_joint", parent="trunk")
    ]


SIX = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")


@pytest.mark.parametrize(
    ("robot", "driven_by", "stacks", "kind"),
    [
        (urdf("turtlebot3_burger", *wheels("wheel_left", "wheel_right")), [TWIST], ["Nav2"],
         "differential drive base, 2 wheels"),
        (urdf("husky", *wheels("front_left_wheel", "front_right_wheel", "rear_left_wheel", "rear_right_wheel")),
         [TWIST], [], "skid-steered base, 4 wheels (unless they are mecanum wheels)"),
        (urdf("ur5e", *chain("revolute", *SIX)), [], ["ros2_control"], "arm of 6 joints"),
        (urdf("jaco", *chain("continuous", *SIX)), [], [], "arm of 6 joints"),
        (urdf("go1", *legs()), [TWIST], [], "legged robot, 4 legs"),
        (urdf("iris", ("rotor_0_joint", "continuous", "base_link", "rotor_0")), [], ["MAVROS"], "drone, 1 rotor"),
        (urdf("crazyflie_quadrotor", ("rotor_0_joint", "continuous", "base_link", "rotor_0")), [TWIST], [],
         "drone, 1 rotor"),
        (urdf("mecanum_bot", *wheels("fl_wheel", "fr_wheel", "rl_wheel", "rr_wheel")), [TWIST], [],
         "omnidirectional base, 4 wheels"),
        (urdf("car", *wheels("rear_left_wheel", "rear_right_wheel"), ("steering", "revolute", "base_link", "axle")),
         [TWIST], [], "car-like base, 2 wheels"),
        (urdf("tiago", *wheels("wheel_left", "wheel_right"), *chain("revolute", *SIX)), [TWIST], [],
         "differential drive base, 2 wheels with an arm of 6 joints"),
        (urdf("fetch", *wheels("l_wheel", "r_wheel"), *chain("prismatic", "torso_lift"),
              *chain("revolute", "head_pan", "head_tilt", parent="torso_lift_link"),
              *chain("revolute", *SIX, "wrist_roll", parent="torso_lift_link")), [TWIST], [],
         "differential drive base, 2 wheels with an arm of 7 joints"),
        (urdf("gantry", *chain("prismatic", "x", "y", "z"), *chain("revolute", "a", parent="z_link")), [], [],
         "arm of 4 joints"),
        (urdf("create", *wheels("left_wheel", "right_wheel", "front_caster")), [TWIST], [],
         "differential drive base, 2 wheels"),
        (urdf("x500", *[joint for name in "abc" for joint in chain("continuous", f"{name}_rotor")]), [], [],
         "drone, 3 rotors"),
        (urdf("boat", *chain("continuous", "left_thruster"), *chain("continuous", "right_thruster")), [], [],
         "vehicle on or under water, 2 thrusters"),
        (urdf("cart", *wheels("left_wheel", "right_wheel"), *chain("fixed", "thruster_camera")), [TWIST], [],
         "differential drive base, 2 wheels"),
        (urdf("spot", *[joint for leg in ("fl", "fr", "rl", "rr")
                        for joint in chain("revolute", f"{leg}_hx", f"{leg}_hy", f"{leg}_kn", parent="body")]), [], [],
         "legged robot, 4 legs"),
        (urdf("baxter", *[joint for side in ("left", "right")
                          for joint in chain("revolute", *(f"{side}_{name}" for name in SIX), parent="torso")]), [], [],
         "2 arms of 6 joints"),
        (None, [TWIST], ["MAVROS"], "drone (or another vehicle with an autopilot)"),
        (None, [TWIST], [], "base driven by velocities"),
        (None, ["ackermann_msgs/msg/AckermannDriveStamped"], [], "car-like base"),
        (None, [], [], "unknown"),
    ],
)  # fmt: skip
def test_the_kind_of_robot_is_told(robot: Urdf | None, driven_by: list[str], stacks: list[str], kind: str) -> None:
    assert kind_of(robot, driven_by, stacks) == kind


@pytest.mark.parametrize(
    ("robot", "kind"),
    [
        (urdf("plane", *chain("continuous", "rotor_puller"), *chain("revolute", "left_aileron"),
              *wheels("left_wheel", "right_wheel", "nose_wheel")), "aircraft with wings, 1 propeller"),
        (urdf("rescue", *chain("fixed", "left_track"), *chain("fixed", "right_track")), "tracked base"),
        (urdf("on_a_rail", *chain("prismatic", "track"), *chain("revolute", *SIX, parent="track_link")),
         "arm of 7 joints"),
        (urdf("hexapod", *[joint for leg in ("lf", "rf") for joint in chain(
            "revolute", f"coxa_{leg}", f"femur_{leg}", f"tibia_{leg}")]), "legged robot, 2 legs"),
        (urdf("kiwi", *wheels("a_wheel", "b_wheel", "c_wheel")), "omnidirectional base, 3 wheels (by their number)"),
        (urdf("hand", *[joint for finger in "abc" for joint in chain(
            "revolute", *(f"{finger}{number}" for number in range(4)))]),
         "base driven by velocities with 3 limbs (arms, legs or fingers) of 4 joints"),
        (urdf("gen3", *chain("continuous", *SIX), wheel=["f_link", f"{SIX[-1]}_link"]), "arm of 6 joints"),
    ],
)  # fmt: skip
def test_kinds_by_what_only_they_have(robot: Urdf, kind: str) -> None:
    assert kind_of(robot, [] if "arm of" in kind else [TWIST], []) == kind


def test_a_hand_is_no_joint_of_its_arm() -> None:
    assert kind_of(urdf("nao", *chain("revolute", *SIX, "LHand")), [], []) == "arm of 6 joints and a gripper"


def test_a_gripper_alone_and_a_pan_tilt_head_are_told() -> None:
    robot = urdf("hand_e", *chain("revolute", "left_knuckle"), *chain("revolute", "right_knuckle"))
    assert kind_of(robot, [], []) == "gripper"
    assert kind_of(urdf("ptu", *chain("revolute", "pan", "tilt")), [], []) == "mechanism of 2 moving joints"


def test_wheels_are_no_joints_of_an_arm_however_they_are_called() -> None:
    turning = [("a", "continuous", "base_link", "left"), ("b", "continuous", "base_link", "right")]
    robot = urdf("base", *turning, wheel=["left", "right"])
    assert [joint.name for joint in wheels_of(robot)] == ["a", "b"]
    assert arms_of(robot) == []


def test_round_links_of_an_arm_are_no_wheels() -> None:
    robot = urdf("jaco", *chain("continuous", *SIX), wheel=[f"{name}_link" for name in SIX[:5]])
    assert kind_of(robot, [], []) == "arm of 6 joints"


FOUR = wheels("fl_wheel", "fr_wheel", "rl_wheel", "rr_wheel")
ROLLERS = [joint for name in ("fl", "fr", "rl", "rr")
           for joint in chain("continuous", f"{name}_roller_1", parent=f"{name}_wheel_link")]  # fmt: skip


@pytest.mark.parametrize(
    ("robot", "controllers", "kind"),
    [
        (urdf("xl", *FOUR), ["mecanum_drive_controller/MecanumDriveController"], "omnidirectional base, 4 wheels"),
        (urdf("xl", *FOUR), ["diff_drive_controller/DiffDriveController"], "skid-steered base, 4 wheels"),
        (urdf("omni_cart", *FOUR), ["diff_drive_controller/DiffDriveController"], "skid-steered base, 4 wheels"),
        (urdf("cart", *FOUR), ["wheel_controller/WheelController"],  # packages of controllers have `roller` in names
         "skid-steered base, 4 wheels (unless they are mecanum wheels)"),
        (urdf("cart", *FOUR, *ROLLERS), [], "omnidirectional base, 4 wheels"),
        (urdf("cart", *FOUR), ["ackermann_steering_controller/AckermannSteeringController"], "car-like base, 4 wheels"),
        (urdf("ridgeback", *wheels("rear_left_wheel", "rear_right_wheel"), *chain("revolute", "front_rocker"),
              *wheels("front_left_wheel", "front_right_wheel", parent="front_rocker_link")),
         ["mecanum_drive_controller/MecanumDriveController"], "omnidirectional base, 4 wheels"),
        (urdf("lab_drone", *chain("continuous", "thruster_1")), [], "drone"),
        (urdf("boat", *chain("revolute", "left_engine"), *chain("revolute", "right_engine"),
              *chain("continuous", "left_propeller", parent="left_engine_link"),
              *chain("continuous", "right_propeller", parent="right_engine_link"),
              wheel=["left_propeller_link", "right_propeller_link"]), [],
         "vehicle with 2 propellers, on water or in the air"),
        (urdf("amphibian", *FOUR, *chain("continuous", "thruster_1")), ["diff_drive_controller/DiffDriveController"],
         "skid-steered base, 4 wheels"),
        (urdf("half", *chain("revolute", "torso_yaw", *SIX)), [], "arm of 6 joints"),
        (urdf("vx300s", *chain("revolute", "waist", "shoulder", "elbow", "roll", "wrist_angle", "wrist_rotate")),
         [], "arm of 6 joints"),
        (urdf("two_arms", *chain("revolute", "torso_yaw"), *chain("revolute", *(f"l_{name}" for name in SIX),
              parent="torso_yaw_link"), *chain("revolute", *(f"r_{name}" for name in SIX), parent="torso_yaw_link")),
         [], "2 arms of 6 joints"),
    ],
)  # fmt: skip
def test_controllers_and_structure_tell_the_kind(robot: Urdf, controllers: list[str], kind: str) -> None:
    assert kind_of(robot, [], [], controllers) == kind
