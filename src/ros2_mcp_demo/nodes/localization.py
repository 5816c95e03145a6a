"""/localization: publishes the robot's pose in the map."""

# pyright: basic
from __future__ import annotations

import math

from geometry_msgs.msg import PoseWithCovarianceStamped

from .. import optional
from ..base import wrapped
from .convert import diagonal, place, transform
from .part import RobotPart

RATE = 10.0


class Localization(RobotPart):
    """Corrects the drift of dead reckoning: publishes /pose in the map, and the transform from map to odom."""

    def __init__(self, robot, namespace):
        super().__init__("localization", robot, namespace)
        self._publisher = self.create_publisher(PoseWithCovarianceStamped, "pose", 10)
        self._tf = optional.tf2_msgs and self.create_publisher(optional.tf2_msgs.TFMessage, "/tf", 100)
        self.declare_switch("enabled", True, "False: localisation is dead and tells nothing")
        self.declare_number("stddev", 0.008, 0.0, 2.0, "Standard deviation of the position [m]")
        self._message = PoseWithCovarianceStamped()

    def tick(self, stamp):
        """Publish when it is due."""
        if not (self.setting("enabled") and self.is_due(RATE)):
            return
        stddev = self.setting("stddev")
        pose = self.robot.localize(stddev)
        self._message.pose.covariance = diagonal(6, {0: 1.1 * stddev**2, 1: 1.1 * stddev**2, 5: 0.3 * stddev**2})
        self.headed(self._message, stamp, "map")
        place(self._message.pose.pose, pose)
        self._publisher.publish(self._message)
        if self._tf:
            odometry = self.robot.base.odometry
            yaw = wrapped(pose.yaw - odometry.yaw)
            x = pose.x - math.cos(yaw) * odometry.x + math.sin(yaw) * odometry.y
            y = pose.y - math.sin(yaw) * odometry.x - math.cos(yaw) * odometry.y
            correction = transform(stamp, self.frame("map"), self.frame("odom"), x, y, yaw=yaw)
            self._tf.publish(optional.tf2_msgs.TFMessage(transforms=[correction]))
