"""The chain of commands from the controller to the wheels: smoother, collision monitor, base; and the EKF."""

# pyright: basic
from __future__ import annotations

import copy
import json
import math
import time

import numpy as np
import rclpy
from geometry_msgs.msg import Twist, TwistStamped
from nav_msgs.msg import Odometry
from rclpy.context import Context
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import LaserScan

from .. import optional
from ..nodes.base_controller import BaseController
from ..nodes.convert import transform
from ..nodes.lifecycle_part import LifecyclePart
from ..nodes.part import RobotPart
from .servers import Managed, declare


class Smoother(Managed, LifecyclePart):
    """Republishes commands unchanged."""

    def __init__(self, robot, namespace, **parameters):
        super().__init__("velocity_smoother", robot, namespace)
        declare(self, parameters)
        self._out = self.create_publisher(Twist, "cmd_vel_smoothed", 10)
        self.create_subscription(Twist, "cmd_vel_nav", self._pass_on, 10)
        self.create_subscription(Odometry, "odom", lambda _: None, 10)

    def _pass_on(self, command):
        if self.is_active:
            self._out.publish(command)


class CollisionMonitor(Managed, LifecyclePart):
    """Republishes commands; sends zeros instead while enough scan points are in a polygon or a source is missing."""

    def __init__(self, robot, namespace, state_type, **parameters):
        super().__init__("collision_monitor", robot, namespace)
        declare(self, parameters)
        self.declare_parameter("PolygonStop.max_points", Parameter.Type.INTEGER)  # as in Nav2: without a value
        self._state_type = state_type
        self._out = self.create_publisher(Twist, "cmd_vel", 10)
        self._states = self.create_publisher(state_type, "collision_monitor_state", 10)
        self._held = None
        self.create_subscription(Twist, "cmd_vel_smoothed", self._pass_on, 10)
        self._scanned_at = -math.inf
        self.create_subscription(LaserScan, "scan", self._see, qos_profile_sensor_data)

    def _see(self, _):
        self._scanned_at = time.monotonic()

    def publish_on(self, topic):
        """Publish the commands on another topic."""
        self.destroy_publisher(self._out)
        self._out = self.create_publisher(Twist, topic, 10)

    def _pass_on(self, command):
        if not self.is_active:
            return
        held = self._why_held()
        if held != self._held:
            self._held = held
            if held == "invalid source":
                self.get_logger().warning(
                    "Robot to stop due to invalid source. Either due to data not published yet, or to lack of new data "
                    "received within the sensor timeout, or if impossible to transform data to base frame"
                )
            self._states.publish(self._state_type(action_type=1 if held else 0, polygon_name=held or ""))
        self._out.publish(Twist() if held else command)

    def _why_held(self):
        """Return the polygon that is not free, `invalid source` if a source is missing, or None."""
        if len(self.setting("observation_sources")) > 1:
            return "invalid source"
        ranges = self.robot.ranges
        if ranges is None or time.monotonic() - self._scanned_at > self.setting("source_timeout"):
            return "invalid source"
        corners = np.array(json.loads(self.setting("PolygonStop.points")))
        angles = -math.pi + np.arange(len(ranges)) * (2 * math.pi / len(ranges))
        reach = np.where(np.isfinite(ranges), ranges, 1e3)
        x, y = reach * np.cos(angles), reach * np.sin(angles)
        inside = (np.abs(x) < corners[:, 0].max()) & (np.abs(y) < corners[:, 1].max())
        return "PolygonStop" if int(inside.sum()) >= self.setting("PolygonStop.min_points") else None


class Base(BaseController):
    """This robot's base subscribes only to /cmd_vel, and publishes its wheel odometry for the EKF."""

    stamp_offset_s = 0.0
    is_silent = False

    def __init__(self, robot, namespace):
        super().__init__(robot, namespace)
        for subscription in [one for one in self.subscriptions if "cmd_vel" in one.topic_name]:
            self.destroy_subscription(subscription)
        self.destroy_publisher(self._odom)
        self._odom = self.create_publisher(Odometry, "wheel/odom", 10)
        if self._tf:
            self.destroy_publisher(self._tf)
            self._tf = None
        self._driver = None
        self.follow()

    def follow(self):
        """Subscribe to /cmd_vel."""
        if self._driver:
            self._driver.destroy_node()
            self._driver.context.try_shutdown()
            self._driver = None
        self._listening = self.create_subscription(Twist, "cmd_vel", self._take, 10)

    def follow_stamped(self):
        """Leave /cmd_vel to a driver that subscribes to TwistStamped, with a participant of its own: a participant has
        one type per topic."""
        self.destroy_subscription(self._listening)
        context = Context()
        rclpy.init(context=context, args=[])
        self._driver = rclpy.create_node("base_driver", context=context, namespace=self.get_namespace())
        self._driver.create_subscription(TwistStamped, "cmd_vel", lambda _: None, 10)

    def _publish(self, stamp):
        if not self.is_silent:
            super()._publish(stamp)

    def tick(self, stamp):
        """Tick like any base, with stamps that may be offset."""
        if self.stamp_offset_s:
            stamp = copy.copy(stamp)
            stamp.sec += math.floor(self.stamp_offset_s)
            nanosec = stamp.nanosec + round((self.stamp_offset_s % 1) * 1e9)
            stamp.sec, stamp.nanosec = stamp.sec + nanosec // 1_000_000_000, nanosec % 1_000_000_000
        super().tick(stamp)


class Ekf(RobotPart):
    """Publishes /odom and the transform from odom to the base for each wheel odometry, as robot_localization does."""

    def __init__(self, robot, namespace):
        super().__init__("ekf_filter_node", robot, namespace)
        self.declare_switch("publish_tf", True, "Whether it tells the transform")
        self._odom = self.create_publisher(Odometry, "odom", 10)
        self._tf = optional.tf2_msgs and self.create_publisher(optional.tf2_msgs.TFMessage, "/tf", 100)
        self.create_subscription(Odometry, "wheel/odom", self._pass_on, 10)

    def _pass_on(self, odometry):
        self._odom.publish(odometry)
        if self._tf and self.setting("publish_tf"):
            pose = self.robot.base.odometry
            parent, child = self.frame("odom"), self.frame("base_link")
            moved = transform(odometry.header.stamp, parent, child, pose.x, pose.y, yaw=pose.yaw)
            self._tf.publish(optional.tf2_msgs.TFMessage(transforms=[moved]))


class Teleop(RobotPart):
    """A remote control that publishes zeros at 20 Hz."""

    def __init__(self, robot, namespace):
        super().__init__("teleop_node", robot, namespace)
        self._commands = self.create_publisher(Twist, "cmd_vel", 10)
        self._sent_at = 0.0

    def tick(self, stamp):  # noqa: ARG002
        """Publish when it is due."""
        if time.monotonic() - self._sent_at >= 0.05:
            self._sent_at = time.monotonic()
            self._commands.publish(Twist())
