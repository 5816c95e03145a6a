"""Poses of coordinate frames in other frames. Pure Python, so that nothing waits for the import of NumPy.

Rotations are unit quaternions in the order of ROS 2 messages: x, y, z, w.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

from ros2_mcp_common.geometry import yaw_rad

Vector: TypeAlias = "tuple[float, float, float]"
"""x, y, z; positions are in metres."""
Quaternion: TypeAlias = "tuple[float, float, float, float]"
"""x, y, z, w."""

_GIMBAL = 1.0 - 1e-12
"""From this sine of the pitch on, roll and yaw are about the same axis (gimbal lock): the roll is then 0."""
_ALIKE = 1.0 - 1e-12
"""From this cosine of half the angle between two rotations on, linear interpolation is exact to 1e-12, while dividing
by the sine of the angle is not."""


@dataclass(frozen=True, slots=True)
class Pose:
    """The pose of a frame in another frame: its origin there, in metres, and its rotation.

    `outer @ inner` is the pose of the inner frame in the outermost one; `pose.applied(point)` transforms a point from
    the frame to the other one.
    """

    translation: Vector = (0.0, 0.0, 0.0)
    rotation: Quaternion = (0.0, 0.0, 0.0, 1.0)

    def __matmul__(self, inner: Pose) -> Pose:
        return Pose(self.applied(inner.translation), normalised(product(self.rotation, inner.rotation)))

    @property
    def inverse(self) -> Pose:
        """The pose of the other frame in this frame."""
        x, y, z, w = self.rotation
        back = (-x, -y, -z, w)
        at = rotated(back, self.translation)
        return Pose((-at[0], -at[1], -at[2]), back)

    def applied(self, point: Vector) -> Vector:
        """Transform a point from the frame to the other frame."""
        turned, origin = rotated(self.rotation, point), self.translation
        return turned[0] + origin[0], turned[1] + origin[1], turned[2] + origin[2]

    @property
    def distance_m(self) -> float:
        """The distance between the two origins, in metres."""
        return math.hypot(*self.translation)

    @property
    def roll_pitch_yaw_rad(self) -> Vector:
        """The rotation about the fixed axes x, y and z, in this order, as in URDF and tf2's `getRPY`."""
        length = math.hypot(*self.rotation) or 1.0
        x, y, z, w = (part / length for part in self.rotation)
        sine = 2 * (w * y - z * x)
        if abs(sine) >= _GIMBAL:
            return 0.0, math.copysign(math.pi / 2, sine), -math.copysign(2, sine) * math.atan2(x, w)
        roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
        return roll, math.asin(sine), math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))

    @property
    def yaw_rad(self) -> float:
        """The heading, seen from above: the angle of the frame's x axis, from x towards y."""
        return yaw_rad(*self.rotation)


def planar(x_m: float, y_m: float, yaw_rad: float = 0.0) -> Pose:
    """Return a pose on the ground."""
    return Pose((x_m, y_m, 0.0), about_z(yaw_rad))


def about_z(yaw_rad: float) -> Quaternion:
    """Return a rotation about the z axis, which points up."""
    return 0.0, 0.0, math.sin(yaw_rad / 2), math.cos(yaw_rad / 2)


def from_roll_pitch_yaw(roll_rad: float, pitch_rad: float, yaw_rad: float) -> Quaternion:
    """Return the rotation about the fixed axes x, y and z, in this order: the inverse of `Pose.roll_pitch_yaw_rad`."""
    about_x = (math.sin(roll_rad / 2), 0.0, 0.0, math.cos(roll_rad / 2))
    about_y = (0.0, math.sin(pitch_rad / 2), 0.0, math.cos(pitch_rad / 2))
    return product(about_z(yaw_rad), product(about_y, about_x))


def product(a: Quaternion, b: Quaternion) -> Quaternion:
    """Return the rotation `b` followed by `a`."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def rotated(q: Quaternion, v: Vector) -> Vector:
    """Rotate a vector: v + 2 w (u × v) + 2 u × (u × v), where u is the quaternion's vector part."""
    x, y, z, w = q
    vx, vy, vz = v
    tx, ty, tz = 2 * (y * vz - z * vy), 2 * (z * vx - x * vz), 2 * (x * vy - y * vx)
    return vx + w * tx + y * tz - z * ty, vy + w * ty + z * tx - x * tz, vz + w * tz + x * ty - y * tx


def normalised(q: Quaternion) -> Quaternion:
    """Return the rotation with length 1. Raises `ValueError` if the length is 0 or not finite."""
    length = math.sqrt(sum(part * part for part in q))
    if not length or not math.isfinite(length):
        raise ValueError("no rotation")
    return q[0] / length, q[1] / length, q[2] / length, q[3] / length


def between(first: Pose, second: Pose, share: float) -> Pose:
    """Interpolate between two poses; `share` is 0 for the first and 1 for the second, as in tf2.

    The position is interpolated linearly, the rotation along the shorter arc at a constant rate (slerp).
    """
    (ax, ay, az), (bx, by, bz) = first.translation, second.translation
    rest = 1.0 - share
    at = (ax * rest + bx * share, ay * rest + by * share, az * rest + bz * share)
    return Pose(at, slerp(first.rotation, second.rotation, share))


def slerp(a: Quaternion, b: Quaternion, share: float) -> Quaternion:
    """Interpolate between two rotations along the shorter arc; `share` is 0 for the first and 1 for the second."""
    cosine = a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]
    if cosine < 0:
        b, cosine = (-b[0], -b[1], -b[2], -b[3]), -cosine
    of_a, of_b = 1.0 - share, share
    if cosine < _ALIKE:
        half_rad = math.acos(cosine)
        of_a, of_b = math.sin(of_a * half_rad) / math.sin(half_rad), math.sin(of_b * half_rad) / math.sin(half_rad)
    return normalised(
        (
            a[0] * of_a + b[0] * of_b,
            a[1] * of_a + b[1] * of_b,
            a[2] * of_a + b[2] * of_b,
            a[3] * of_a + b[3] * of_b,
        )
    )


def angle_between_rad(a: Quaternion, b: Quaternion) -> float:
    """Return the angle of the rotation from one pose to the other, 0 to π.

    Quaternions may have any length; the result is 0 if one is all zeros.
    """
    x, y, z, w = product((-a[0], -a[1], -a[2], a[3]), b)
    return 2 * math.atan2(math.hypot(x, y, z), abs(w))


def mean_of(poses: Sequence[Pose]) -> Pose:
    """Return the mean of poses that are near each other: of positions, and of quaternions with equal signs.

    For rotations within some ten degrees this is the least-squares mean, to a part in a thousand.
    """
    count, reference = len(poses), poses[0].rotation
    sums = [0.0] * 7
    for pose in poses:
        q = pose.rotation
        sign = 1.0 if sum(a * b for a, b in zip(q, reference, strict=True)) >= 0 else -1.0
        for place, part in enumerate((*pose.translation, *(sign * part for part in q))):
            sums[place] += part
    at = (sums[0] / count, sums[1] / count, sums[2] / count)
    return Pose(at, normalised((sums[3], sums[4], sums[5], sums[6])))
