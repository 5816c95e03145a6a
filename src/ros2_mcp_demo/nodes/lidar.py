"""/lidar: a laser scanner with a field of view of 360°."""

# pyright: basic
from __future__ import annotations

import array
import math

import numpy as np
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import LaserScan

from ..simulation import BEAMS, RANGE_MAX, RANGE_MIN
from .part import ERROR, OK, WARN, RobotPart

OWN_BEAMS, OWN_RANGE = slice(0, 13), 0.13
"""Beams that hit a part of the robot if that fault is planted, and their range in m."""


class Lidar(RobotPart):
    """The driver of the laser scanner. `sees_itself`: a part of the robot behind the scanner blocks some beams.
    `turned_deg`: it is mounted turned to the left by this, which its transform does not say.
    """

    sees_itself = False
    turned_deg = 0

    def __init__(self, robot, namespace):
        super().__init__("lidar", robot, namespace)
        self.declare_switch("enabled", True, "False: the scanner is dead and publishes nothing")
        self.declare_number("rate", 10.0, 0.5, 25.0, "Turns per second [Hz]")
        self.declare_number("noise_stddev", 0.01, 0.0, 0.5, "Standard deviation of a range [m]")
        self.declare_fact("serial_number", "LD06-31416", "Serial number of the scanner")
        self._publisher = self.create_publisher(LaserScan, "scan", qos_profile_sensor_data)

    def tick(self, stamp):
        """Publish a scan when it is due."""
        rate = self.setting("rate")
        if not self.setting("enabled"):
            self.robot.ranges = None
        elif self.is_due(rate):
            self.robot.ranges = self.robot.scan(self.setting("noise_stddev"))
            if self.sees_itself:
                self.robot.ranges[OWN_BEAMS] = OWN_RANGE
            self._publisher.publish(self._message(stamp, rate))

    def diagnosis(self):
        """Return whether the scanner works."""
        values = {"rate [Hz]": f"{self.setting('rate'):g}", "noise [m]": f"{self.setting('noise_stddev'):g}"}
        if self.robot.ranges is None:
            return ERROR, "no data from the scanner", values
        if self.setting("noise_stddev") > 0.05:
            return WARN, "ranges are noisy", values
        return OK, "scanning", values

    def _message(self, stamp, rate):
        message = self.headed(LaserScan(), stamp, "laser")
        message.angle_min = -math.pi
        message.angle_increment = 2 * math.pi / BEAMS
        message.angle_max = message.angle_min + (BEAMS - 1) * message.angle_increment
        message.scan_time = 1.0 / rate
        message.range_min, message.range_max = RANGE_MIN, RANGE_MAX
        ranges = np.roll(self.robot.ranges, -round(self.turned_deg * BEAMS / 360))
        message.ranges = array.array("f", ranges.tobytes())
        return message
