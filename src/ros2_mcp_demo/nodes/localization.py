"""/localization: where the robot is in the map."""

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
    """Corrects the drift of dead reckoning: /pose in the map, and the transform from map to odom."""

    def __init__(self, robot, namespace):
        super().__init__("localization", robot, namespace)
        self._publisher = self.create_publisher(PoseWithCovarianceStamped, "pose", 10)
        self._tf = optional.tf2_msgs and self.create_publisher(optional.tf2_msgs.TFMessage, "/tf", 100)
        self._message = PoseWithCovarianceStamped()
        self._message.pose.covariance = diagonal(6, {0: 7e-5, 1: 7e-5, 5: 2e-5})

    def tick(self, stamp):
        """Publish when it is time."""
        if not self.is_due(RATE):
            return
        pose = self.robot.localize()
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
