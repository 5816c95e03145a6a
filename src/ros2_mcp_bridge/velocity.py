"""The types of messages that keep a robot moving until another one comes. Both sides use this table; needs no ROS."""

from __future__ import annotations

from collections.abc import Mapping

VELOCITY_TYPES: Mapping[str, bool] = {
    "geometry_msgs/msg/Twist": False,
    "geometry_msgs/msg/TwistStamped": True,
    "ackermann_msgs/msg/AckermannDrive": False,
    "ackermann_msgs/msg/AckermannDriveStamped": True,
}
"""The default value of each of these types is its zero, which stops the robot; True where it has a header, with a stamp
and a frame."""
