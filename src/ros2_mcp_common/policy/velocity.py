"""The types of messages that keep a robot moving until another one comes. Both sides use this table; needs no ROS."""

from __future__ import annotations

from collections.abc import Collection, Mapping

VELOCITY_TYPES: Mapping[str, bool] = {
    "geometry_msgs/msg/Twist": False,
    "geometry_msgs/msg/TwistStamped": True,
    "ackermann_msgs/msg/AckermannDrive": False,
    "ackermann_msgs/msg/AckermannDriveStamped": True,
}
"""The default value of each of these types is its zero, which stops the robot; True where it has a header, with a stamp
and a frame."""
HOLD_TYPES: Collection[str] = ("trajectory_msgs/msg/JointTrajectory",)
"""What is followed by itself to its end, and ended before by a hold where the joints are measured to be."""
MOTION_TYPES: frozenset[str] = frozenset((*VELOCITY_TYPES, *HOLD_TYPES))
"""All types of which it is known what ends a motion."""
