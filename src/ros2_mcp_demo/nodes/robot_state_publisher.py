"""/robot_state_publisher: publishes the robot's description and its static transforms, both latched."""

# pyright: basic
from __future__ import annotations

from geometry_msgs.msg import Quaternion
from std_msgs.msg import String

from .. import optional
from ..base import RADIUS, WHEEL_RADIUS, WHEEL_SEPARATION
from ..picture import EYE_HEIGHT
from ..simulation import CAMERA_FORWARD
from .convert import transform
from .part import RobotPart

LASER_HEIGHT = 0.22
IMU_HEIGHT = 0.1

_JOINT = """  <joint name="{prefix}{name}_joint" type="{kind}">
    <parent link="{prefix}{parent}"/><child link="{prefix}{child}"/>
    <origin xyz="{x:g} {y:g} {z:g}" rpy="{rpy}"/><axis xyz="0 1 0"/>
  </joint>
"""
_WHEEL = f'<visual><geometry><cylinder radius="{WHEEL_RADIUS}" length="0.03"/></geometry></visual>'
_BODY = f'<visual><geometry><cylinder radius="{RADIUS}" length="0.15"/></geometry></visual>'


class RobotStatePublisher(RobotPart):
    """Publishes /robot_description and /tf_static once."""

    def __init__(self, robot, namespace):
        super().__init__("robot_state_publisher", robot, namespace)
        self._description = self.create_latched_publisher(String, "robot_description")
        self._tf = optional.tf2_msgs and self.create_latched_publisher(optional.tf2_msgs.TFMessage, "/tf_static")
        self._published = False

    def tick(self, stamp):
        """Publish both on the first call."""
        if self._published:
            return
        self._published = True
        self._description.publish(String(data=description(self.frame(""))))
        if self._tf:
            self._tf.publish(optional.tf2_msgs.TFMessage(transforms=self._mounts(stamp)))

    def _mounts(self, stamp):
        base, camera, optical = map(self.frame, ("base_link", "camera_link", "camera_optical"))
        into_picture = transform(stamp, camera, optical)
        into_picture.transform.rotation = Quaternion(x=-0.5, y=0.5, z=-0.5, w=0.5)
        return [
            transform(stamp, base, self.frame("laser"), z=LASER_HEIGHT),
            transform(stamp, base, self.frame("imu_link"), z=IMU_HEIGHT),
            transform(stamp, base, camera, CAMERA_FORWARD, z=EYE_HEIGHT),
            into_picture,
        ]


def description(prefix=""):
    """Return the robot's URDF; `prefix` is prepended to the name of every link and joint."""
    half = WHEEL_SEPARATION / 2
    visuals = {"base_link": _BODY, "left_wheel": _WHEEL, "right_wheel": _WHEEL}
    names = (*visuals, "laser", "imu_link", "camera_link", "camera_optical")
    links = "".join(f'  <link name="{prefix}{name}">{visuals.get(name, "")}</link>\n' for name in names)
    joints = (
        ("left_wheel", "continuous", "base_link", "left_wheel", 0, half, WHEEL_RADIUS, "-1.5708 0 0"),
        ("right_wheel", "continuous", "base_link", "right_wheel", 0, -half, WHEEL_RADIUS, "-1.5708 0 0"),
        ("laser", "fixed", "base_link", "laser", 0, 0, LASER_HEIGHT, "0 0 0"),
        ("imu", "fixed", "base_link", "imu_link", 0, 0, IMU_HEIGHT, "0 0 0"),
        ("camera", "fixed", "base_link", "camera_link", CAMERA_FORWARD, 0, EYE_HEIGHT, "0 0 0"),
        ("optical", "fixed", "camera_link", "camera_optical", 0, 0, 0, "-1.5708 0 -1.5708"),
    )
    keys = ("name", "kind", "parent", "child", "x", "y", "z", "rpy")
    body = "".join(_JOINT.format(prefix=prefix, **dict(zip(keys, joint))) for joint in joints)  # noqa: B905 (3.8)
    return f'<?xml version="1.0"?>\n<robot name="ros2_mcp_demo">\n{links}{body}</robot>\n'
