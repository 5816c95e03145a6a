"""The base class of the robot's nodes."""

# pyright: basic
from __future__ import annotations

import math
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


class RobotPart(Node):
    """A node of the robot: on each `tick` it reads the simulation and publishes what is due."""

    needs_executor = True

    def __init__(self, name, robot, namespace="", **options):
        super().__init__(name, namespace=namespace or None, **options)
        self.robot = robot
        self._frame_prefix = namespace.strip("/")
        self._last_due = {}

    def tick(self, stamp):
        """Called after each step of the simulation; `stamp` is the current time as a message."""

    def diagnosis(self):
        """Return (level, message, {key: value}) for /diagnostics, or None."""

    def frame(self, name):
        """Return the name of a coordinate frame, prefixed with the robot's namespace if it has one."""
        return f"{self._frame_prefix}/{name}" if self._frame_prefix else name

    def headed(self, message, stamp, frame):
        """Set the stamp and the frame in a message's header; return the message."""
        message.header.stamp, message.header.frame_id = stamp, self.frame(frame)
        return message

    def is_due(self, rate, what=""):
        """Whether `what` is due again, at `rate` Hz of simulated time; missed times are skipped."""
        now, period = self.robot.now, 1.0 / rate
        on_time = self._last_due.get(what, -math.inf) + period
        if now < on_time - 1e-6:
            return False
        self._last_due[what] = on_time if now < on_time + period else now
        return True

    def create_latched_publisher(self, message_type, topic):
        """Create a publisher whose last message is also sent to later subscribers."""
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        return self.create_publisher(message_type, topic, latched)

    def setting(self, name) -> Any:
        """Return the present value of a parameter."""
        return self.get_parameter(name).value

    def declare_number(self, name, default, lowest, highest, description):
        """Declare a floating-point parameter with a range, which rclpy enforces and reports."""
        limits = FloatingPointRange(from_value=lowest, to_value=highest)
        described = ParameterDescriptor(description=description, floating_point_range=[limits])
        self.declare_parameter(name, default, described)

    def declare_switch(self, name, default, description):
        """Declare a boolean parameter."""
        self.declare_parameter(name, default, ParameterDescriptor(description=description))

    def declare_text(self, name, default, description):
        """Declare a string parameter."""
        self.declare_parameter(name, default, ParameterDescriptor(description=description))

    def declare_fact(self, name, value, description):
        """Declare a read-only parameter."""
        self.declare_parameter(name, value, ParameterDescriptor(description=description, read_only=True))


def never_called(*_):
    """Raise: a callback that rclpy requires, although the robot's own loop does the work."""
    raise NotImplementedError("the robot's loop takes requests and goals itself")
