"""/quadcopter: the drone's own velocity input, odometry, transforms and description; its parameters set the weather."""

# pyright: basic
from __future__ import annotations

import math

import numpy as np
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import IntegerRange, ParameterDescriptor, SetParametersResult
from std_msgs.msg import String

from .. import optional
from ..nodes.convert import transform
from ..nodes.part import RobotPart
from .attitude import attitude
from .description import LEGS, MOUNTS, description

ODOMETRY_HZ = 20.0
TELEOP_TOPIC = "X3/cmd_vel"
"""As in Gazebo's teleop world of the quadcopter: m/s forward, left and up, and rad/s of yaw, in the body's frame."""


class Quadcopter(RobotPart):
    """Flies by velocity commands of its own, and publishes its pose."""

    def __init__(self, robot, namespace):
        super().__init__("quadcopter", robot, namespace)
        self.declare_number("wind_east", robot.frame.wind.mean[0], -8.0, 8.0, "Wind towards east [m/s]")
        self.declare_number("wind_north", robot.frame.wind.mean[1], -8.0, 8.0, "Wind towards north [m/s]")
        self.declare_number("gusts", robot.frame.wind.gusts, 0.0, 3.0, "Standard deviation of the gusts [m/s]")
        self.declare_number("ceiling", robot.autopilot.fence_altitude, 5.0, 500.0, "FENCE_ALT_MAX, above home [m]")
        fast = ParameterDescriptor(
            description="Its seconds in one of ours", integer_range=[IntegerRange(from_value=1, to_value=20, step=1)]
        )
        self.declare_parameter("speedup", robot.speedup, fast)
        self.add_on_set_parameters_callback(self._on_set)
        self._odometry = self.create_publisher(Odometry, "odom", 10)
        self._description = self.create_latched_publisher(String, "robot_description")
        tf2 = optional.tf2_msgs
        self._tf = tf2 and self.create_publisher(tf2.TFMessage, "/tf", 100)
        self._static = tf2 and self.create_latched_publisher(tf2.TFMessage, "/tf_static")
        self.create_subscription(Twist, TELEOP_TOPIC, self._on_command, 10)
        self._is_new = True

    def tick(self, stamp):
        """Publish what is due."""
        if self._is_new:
            self._is_new = False
            self._description.publish(String(data=description(self.frame(""))))
            if self._static:
                mounts = [
                    transform(stamp, self.frame("base_link"), self.frame(name), *place)
                    for name, place in MOUNTS.items()
                ]
                self._static.publish(optional.tf2_msgs.TFMessage(transforms=mounts))
        if self.is_due(ODOMETRY_HZ):
            self._publish(stamp)

    def _publish(self, stamp):
        body, (x, y, z) = self.robot.frame, map(float, self.robot.localize())
        message = self.headed(Odometry(child_frame_id=self.frame("base_link")), stamp, "map")
        place = message.pose.pose.position
        place.x, place.y, place.z = x, y, z + LEGS
        message.pose.pose.orientation = attitude(body)
        forward, left, up = _in_body(body)
        linear = message.twist.twist.linear
        linear.x, linear.y, linear.z = forward, left, up
        message.twist.twist.angular.z = float(body.yaw_rate)
        self._odometry.publish(message)
        if self._tf:
            moved = transform(stamp, self.frame("map"), self.frame("base_link"), x, y, z + LEGS)
            moved.transform.rotation = message.pose.pose.orientation
            self._tf.publish(optional.tf2_msgs.TFMessage(transforms=[moved]))

    def _on_command(self, command):
        linear, yaw = command.linear, self.robot.frame.yaw
        numbers = (linear.x, linear.y, linear.z, command.angular.z)
        if not all(map(math.isfinite, numbers)):
            self.get_logger().error("a velocity command that is not finite was ignored")
            return
        along, across = math.cos(yaw), math.sin(yaw)
        velocity = (linear.x * along - linear.y * across, linear.x * across + linear.y * along, linear.z)
        self.robot.autopilot.fly_by_hand(velocity, command.angular.z)

    def _on_set(self, parameters):
        wind = self.robot.frame.wind
        for parameter in parameters:
            if parameter.name == "wind_east":
                wind.mean = (parameter.value, wind.mean[1])
            elif parameter.name == "wind_north":
                wind.mean = (wind.mean[0], parameter.value)
            elif parameter.name == "gusts":
                wind.gusts = parameter.value
            elif parameter.name == "ceiling":
                self.robot.autopilot.fence_altitude = parameter.value
            elif parameter.name == "speedup":
                self.robot.speedup = parameter.value
        return SetParametersResult(successful=True)


def _in_body(body):
    """Return the velocity forward, left and up in m/s, in a frame that turns but does not tilt with the body."""
    along, across = np.cos(body.yaw), np.sin(body.yaw)
    east, north, up = map(float, body.velocity)
    return float(east * along + north * across), float(north * along - east * across), up
