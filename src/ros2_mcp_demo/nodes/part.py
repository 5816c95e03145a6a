"""What all nodes of the robot have in common."""

# pyright: basic
from __future__ import annotations

import math
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.node import Node

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


class RobotPart(Node):
    """A node of the robot: looks at the simulation and publishes what is due whenever `tick` is called."""

    def __init__(self, name, robot, namespace="", **options):
        super().__init__(name, namespace=namespace or None, **options)
        self.robot = robot
        self._frame_prefix = namespace.strip("/")

    def tick(self, stamp):
        """One step of the simulation has passed; `stamp` is the time now as a message."""

    def diagnosis(self):
        """None, or (level, message, {key: value}) for /diagnostics."""

    def frame(self, name):
        """The name of a coordinate frame, under the robot's namespace if it has one."""
        return f"{self._frame_prefix}/{name}" if self._frame_prefix else name

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

    def declare_fact(self, name, value, description):
        """A read-only parameter."""
        self.declare_parameter(name, value, ParameterDescriptor(description=description, read_only=True))


class Rhythm:
    """Tells when something that happens at a rate is due, on the simulation's clock."""

    def __init__(self):
        self._last = -math.inf

    def is_due(self, now, rate):
        """Whether it is time again at `rate` Hz; a missed time is not made up for."""
        period = 1.0 / rate
        if now < self._last + period - 1e-6:
            return False
        on_time = self._last + period
        self._last = on_time if now < on_time + period else now
        return True
