"""From the simulation's numbers to ROS messages' fields."""

# pyright: basic
from __future__ import annotations

import array
import math

from geometry_msgs.msg import Quaternion, TransformStamped


def quaternion(yaw):
    """The rotation by `yaw` rad about the z axis."""
    return Quaternion(z=math.sin(yaw / 2), w=math.cos(yaw / 2))


def place(pose_message, pose):
    """Write a planar pose into a geometry_msgs/Pose."""
    pose_message.position.x, pose_message.position.y = pose.x, pose.y
    pose_message.orientation = quaternion(pose.yaw)


def transform(stamp, parent, child, x=0.0, y=0.0, z=0.0, yaw=0.0):
    """A geometry_msgs/TransformStamped."""
    message = TransformStamped()
    message.header.stamp, message.header.frame_id, message.child_frame_id = stamp, parent, child
    translation = message.transform.translation
    translation.x, translation.y, translation.z = x, y, z
    message.transform.rotation = quaternion(yaw)
    return message


def octets(values):
    """Bytes of a numpy array as ROS wants uint8[]; `array` spares rclpy a check of every element."""
    return array.array("B", values.tobytes())


def diagonal(size, values):
    """A covariance matrix, row by row, with {index: variance} on its diagonal."""
    matrix = [0.0] * (size * size)
    for index, variance in values.items():
        matrix[index * (size + 1)] = variance
    return matrix
