"""The drone's attitude as a message."""

# pyright: basic
from __future__ import annotations

import math

from geometry_msgs.msg import Quaternion


def attitude(frame):
    """Return the attitude of an airframe as a geometry_msgs/Quaternion."""
    roll, pitch = frame.tilt
    cr, sr, cp, sp = math.cos(roll / 2), math.sin(roll / 2), math.cos(pitch / 2), math.sin(pitch / 2)
    cy, sy = math.cos(frame.yaw / 2), math.sin(frame.yaw / 2)
    return Quaternion(
        x=sr * cp * cy - cr * sp * sy,
        y=cr * sp * cy + sr * cp * sy,
        z=cr * cp * sy - sr * sp * cy,
        w=cr * cp * cy + sr * sp * sy,
    )
