"""The arm's joints with their limits, its links, and its URDF. No ROS."""

# pyright: basic
from __future__ import annotations

import math
from dataclasses import dataclass

ARM = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint")
GRIPPER = ("gripper_joint",)


@dataclass(frozen=True)
class Joint:
    """A joint of the arm. `lower` and `upper` in rad (m for prismatic), `velocity` per s, `acceleration` per s²; `xyz`
    is the origin of the child in its parent, in m; `length` and `radius` (m) are those of the child's tube along z."""

    name: str
    parent: str
    child: str
    axis: str
    xyz: tuple[float, float, float]
    lower: float
    upper: float
    velocity: float
    acceleration: float
    effort: float
    length: float
    radius: float
    kind: str = "revolute"


JOINTS = (
    Joint(
        "shoulder_pan_joint", "base_link", "shoulder_link", "0 0 1", (0, 0, 0.1), -3.1, 3.1, 1.5, 4.0, 80, 0.12, 0.07
    ),
    Joint(
        "shoulder_lift_joint",
        "shoulder_link",
        "upper_arm_link",
        "0 1 0",
        (0, 0, 0.12),
        -1.8,
        1.8,
        1.2,
        3.0,
        80,
        0.4,
        0.05,
    ),
    Joint("elbow_joint", "upper_arm_link", "forearm_link", "0 1 0", (0, 0, 0.4), -2.6, 2.6, 1.5, 4.0, 50, 0.35, 0.04),
    Joint("wrist_1_joint", "forearm_link", "wrist_1_link", "0 1 0", (0, 0, 0.35), -2.0, 2.0, 2.0, 6.0, 20, 0.1, 0.035),
    Joint("wrist_2_joint", "wrist_1_link", "wrist_2_link", "0 0 1", (0, 0, 0.1), -3.1, 3.1, 2.0, 6.0, 20, 0.08, 0.035),
    Joint("wrist_3_joint", "wrist_2_link", "tool_link", "0 1 0", (0, 0, 0.08), -2.0, 2.0, 2.0, 6.0, 20, 0.06, 0.03),
    Joint(
        "gripper_joint",
        "tool_link",
        "left_finger",
        "0 1 0",
        (0, 0, 0.06),
        0.0,
        0.04,
        0.1,
        0.5,
        30,
        0.08,
        0.01,
        "prismatic",
    ),
)
BY_NAME = {joint.name: joint for joint in JOINTS}
FIXED = (("base_joint", "world", "base_link", (0, 0, 0)), ("camera_joint", "tool_link", "camera_link", (0.05, 0, 0.02)))
"""Name, parent, child and origin (m) of the fixed joints."""
HOME = {"shoulder_lift_joint": -0.6, "elbow_joint": 1.2, "wrist_1_joint": 0.6, "gripper_joint": 0.02}
"""Start positions of the joints; 0 for the others."""


def description(prefix=""):
    """Return the arm's URDF; `prefix` is prepended to the name of every link and joint."""
    tubes = {joint.child: joint for joint in JOINTS}
    names = ["world", "base_link", *tubes, "right_finger", "camera_link"]
    links = "".join(f'  <link name="{prefix}{name}">{_shape(name, tubes.get(name))}</link>\n' for name in names)
    fixed = "".join(
        f'  <joint name="{prefix}{name}" type="fixed"><parent link="{prefix}{parent}"/><child link="{prefix}{child}"/>'
        f'<origin xyz="{_text(xyz)}"/></joint>\n'
        for name, parent, child, xyz in FIXED
    )
    moving = "".join(_joint(joint, prefix) for joint in JOINTS)
    mimic = (
        f'  <joint name="{prefix}right_finger_joint" type="prismatic"><parent link="{prefix}tool_link"/>'
        f'<child link="{prefix}right_finger"/><origin xyz="0 0 0.06"/><axis xyz="0 -1 0"/>'
        f'<limit lower="0" upper="0.04" velocity="0.1" effort="30"/><mimic joint="{prefix}gripper_joint"/></joint>\n'
    )
    interfaces = (
        '<command_interface name="position"/><state_interface name="position"/><state_interface name="velocity"/>'
    )
    controlled = "".join(f'    <joint name="{prefix}{joint.name}">{interfaces}</joint>\n' for joint in JOINTS)
    control = f'  <ros2_control name="arm" type="system">\n{controlled}  </ros2_control>\n'
    return f'<?xml version="1.0"?>\n<robot name="ros2_mcp_arm">\n{links}{fixed}{moving}{mimic}{control}</robot>\n'


def tool_point(positions):
    """Return x, y and z (m) of `tool_link` in `world`, computed from joint positions by name."""
    x, y, z = 0.0, 0.0, 0.06
    for joint in reversed([BY_NAME[name] for name in ARM]):
        angle = positions.get(joint.name, 0.0)
        cosine, sine = math.cos(angle), math.sin(angle)
        if joint.axis == "0 1 0":
            x, z = x * cosine + z * sine, z * cosine - x * sine
        else:
            x, y = x * cosine - y * sine, x * sine + y * cosine
        x, y, z = x + joint.xyz[0], y + joint.xyz[1], z + joint.xyz[2]
    return x, y, z


def _joint(joint, prefix):
    return (
        f'  <joint name="{prefix}{joint.name}" type="{joint.kind}"><parent link="{prefix}{joint.parent}"/>'
        f'<child link="{prefix}{joint.child}"/><origin xyz="{_text(joint.xyz)}"/><axis xyz="{joint.axis}"/>'
        f'<limit lower="{joint.lower:g}" upper="{joint.upper:g}" velocity="{joint.velocity:g}" '
        f'effort="{joint.effort:g}"/></joint>\n'
    )


def _shape(name, joint):
    if name == "base_link":
        shape = '<origin xyz="0 0 0.05"/><geometry><cylinder radius="0.1" length="0.1"/></geometry>'
    elif name == "right_finger" or (joint and joint.kind == "prismatic"):
        shape = '<origin xyz="0 0 0.04"/><geometry><box size="0.02 0.01 0.08"/></geometry>'
    elif joint:
        tube = f'<cylinder radius="{joint.radius:g}" length="{joint.length:g}"/>'
        shape = f'<origin xyz="0 0 {joint.length / 2:g}"/><geometry>{tube}</geometry>'
    else:
        return ""
    return f"<visual>{shape}</visual><collision>{shape}</collision>"


def _text(xyz):
    return " ".join(f"{number:g}" for number in xyz)
