"""Conversions from the simulation's numbers to fields of ROS messages."""

# pyright: basic
from __future__ import annotations

import array
import math

from geometry_msgs.msg import Quaternion, TransformStamped


def quaternion(yaw):
    """Return the rotation by `yaw` rad about the z axis."""
    return Quaternion(z=math.sin(yaw / 2), w=math.cos(yaw / 2))


def place(pose_message, pose):
    """Write a planar pose into a geometry_msgs/Pose."""
    pose_message.position.x, pose_message.position.y = pose.x, pose.y
    pose_message.orientation = quaternion(pose.yaw)


def transform(stamp, parent, child, x=0.0, y=0.0, z=0.0, yaw=0.0):
    """Return a geometry_msgs/TransformStamped."""
    message = TransformStamped()
    message.header.stamp, message.header.frame_id, message.child_frame_id = stamp, parent, child
    translation = message.transform.translation
    translation.x, translation.y, translation.z = x, y, z
    message.transform.rotation = quaternion(yaw)
    return message


def octets(values):
    """Return a numpy array's bytes for a uint8[] field; an `array` spares rclpy the check of every element."""
    return array.array("B", values.tobytes())


def diagonal(size, values):
    """Return a covariance matrix, row by row, with {index: variance} on its diagonal."""
    matrix = [0.0] * (size * size)
    for index, variance in values.items():
        matrix[index * (size + 1)] = variance
    return matrix
