"""The message types that keep a robot moving until another message comes.

Server and bridge share them. Needs no ROS.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

VELOCITY_TYPES: Mapping[str, bool] = {
    "geometry_msgs/msg/Twist": False,
    "geometry_msgs/msg/TwistStamped": True,
    "ackermann_msgs/msg/AckermannDrive": False,
    "ackermann_msgs/msg/AckermannDriveStamped": True,
}
"""The types of velocity commands.

The default value of each is its zero, which stops the robot. True if the type has a header with a stamp and a frame.
"""
SPEED_LIMIT = "nav2_msgs/msg/SpeedLimit"
"""By this type Nav2's controllers are told how fast they may drive."""
HOLD_TYPES: Collection[str] = ("trajectory_msgs/msg/JointTrajectory",)
"""The types of commands that a controller executes to the end, unless a hold at the
measured joint positions ends it.
"""
MOTION_TYPES: frozenset[str] = frozenset((*VELOCITY_TYPES, *HOLD_TYPES))
"""All types for which the message that ends the motion is known."""


def planar(message: Any) -> tuple[float, float, float]:
    """Return the speeds of a velocity command, decoded by rclpy: forward and left in m/s, and to the left in rad/s.

    How fast a car turns depends on its wheelbase, which is not in its command: 0.
    """
    for name in ("twist", "drive"):
        message = getattr(message, name, message)
    if hasattr(message, "speed"):
        return float(message.speed), 0.0, 0.0
    return float(message.linear.x), float(message.linear.y), float(message.angular.z)
