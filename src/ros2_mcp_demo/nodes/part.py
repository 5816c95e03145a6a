"""What all nodes of the robot have in common."""

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
    """A node of the robot: looks at the simulation and publishes what is due whenever `tick` is called."""

    needs_executor = True

    def __init__(self, name, robot, namespace="", **options):
        super().__init__(name, namespace=namespace or None, **options)
        self.robot = robot
        self._frame_prefix = namespace.strip("/")
        self._last_due = {}

    def tick(self, stamp):
        """One step of the simulation has passed; `stamp` is the time now as a message."""

    def diagnosis(self):
        """None, or (level, message, {key: value}) for /diagnostics."""

    def frame(self, name):
        """The name of a coordinate frame, under the robot's namespace if it has one."""
        return f"{self._frame_prefix}/{name}" if self._frame_prefix else name

    def headed(self, message, stamp, frame):
        """The message, with a header of that time and coordinate frame."""
        message.header.stamp, message.header.frame_id = stamp, self.frame(frame)
        return message

    def is_due(self, rate, what=""):
        """Whether it is time again for `what`, at `rate` Hz of the simulation's clock; a missed time is not made up."""
        now, period = self.robot.now, 1.0 / rate
        on_time = self._last_due.get(what, -math.inf) + period
        if now < on_time - 1e-6:
            return False
        self._last_due[what] = on_time if now < on_time + period else now
        return True

    def create_latched_publisher(self, message_type, topic):
        """A publisher whose last message is sent to those who subscribe later, too."""
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        return self.create_publisher(message_type, topic, latched)

    def setting(self, name) -> Any:
        """The present value of a parameter."""
        return self.get_parameter(name).value

    def declare_number(self, name, default, lowest, highest, description):
        """A floating-point parameter with a range, which rclpy enforces and tells others."""
        limits = FloatingPointRange(from_value=lowest, to_value=highest)
        described = ParameterDescriptor(description=description, floating_point_range=[limits])
        self.declare_parameter(name, default, described)

    def declare_switch(self, name, default, description):
        """A boolean parameter."""
        self.declare_parameter(name, default, ParameterDescriptor(description=description))

    def declare_text(self, name, default, description):
        """A parameter that is a text."""
        self.declare_parameter(name, default, ParameterDescriptor(description=description))

    def declare_fact(self, name, value, description):
        """A read-only parameter."""
        self.declare_parameter(name, value, ParameterDescriptor(description=description, read_only=True))


def never_called(*_):
    """A callback for rclpy to hold where the robot's own loop does the work."""
    raise NotImplementedError("the robot's loop takes requests and goals itself")
