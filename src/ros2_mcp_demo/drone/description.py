"""The drone's URDF, made by this project. No ROS."""

# pyright: basic
from __future__ import annotations

ARM_LENGTH = 0.22
"""Distance from the centre to each rotor along x and along y, in m."""
ROTOR_RADIUS = 0.127
LEGS = 0.12
"""Height of base_link above the ground when the drone stands, in m."""
MASS = 1.5
MOUNTS = {"imu_link": (0.0, 0.0, 0.0), "gps_link": (0.0, 0.0, 0.08), "camera_link": (0.12, 0.0, -0.03)}
"""Frames fixed to base_link, with their positions in m."""
ROTORS = {
    "front_left": (ARM_LENGTH, ARM_LENGTH),
    "front_right": (ARM_LENGTH, -ARM_LENGTH),
    "rear_left": (-ARM_LENGTH, ARM_LENGTH),
    "rear_right": (-ARM_LENGTH, -ARM_LENGTH),
}

_BASE = """  <link name="{prefix}base_link">
    <inertial>
      <mass value="{mass}"/><inertia ixx="0.03" ixy="0" ixz="0" iyy="0.03" iyz="0" izz="0.05"/>
    </inertial>
    <visual>{body}</visual><collision>{body}</collision>
  </link>
"""
_ROTOR = """  <link name="{prefix}{name}_rotor">
    <visual><geometry><cylinder radius="{radius}" length="0.02"/></geometry></visual>
  </link>
  <joint name="{prefix}{name}_rotor_joint" type="continuous">
    <parent link="{prefix}base_link"/><child link="{prefix}{name}_rotor"/>
    <origin xyz="{x:g} {y:g} 0.05" rpy="0 0 0"/><axis xyz="0 0 1"/>
  </joint>
"""
_MOUNT = """  <link name="{prefix}{name}"/>
  <joint name="{prefix}{name}_joint" type="fixed">
    <parent link="{prefix}base_link"/><child link="{prefix}{name}"/>
    <origin xyz="{x:g} {y:g} {z:g}" rpy="0 0 0"/>
  </joint>
"""


def description(prefix=""):
    """Return the drone's URDF; `prefix` is prepended to the name of every link and joint."""
    side = 2 * ARM_LENGTH
    body = f'<geometry><box size="{side:g} {side:g} 0.1"/></geometry>'
    base = _BASE.format(prefix=prefix, mass=MASS, body=body)
    rotors = "".join(
        _ROTOR.format(prefix=prefix, name=name, radius=ROTOR_RADIUS, x=x, y=y) for name, (x, y) in ROTORS.items()
    )
    mounts = "".join(_MOUNT.format(prefix=prefix, name=name, x=x, y=y, z=z) for name, (x, y, z) in MOUNTS.items())
    return f'<?xml version="1.0"?>\n<robot name="ros2_mcp_demo_drone">\n{base}{rotors}{mounts}</robot>\n'
