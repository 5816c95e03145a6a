"""A subscriber that asks for more than the robot's imu offers, so that they never exchange a message."""

from __future__ import annotations

import signal
import sys

import rclpy
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu

rclpy.init()
node = rclpy.create_node("deaf_logger")
node.create_subscription(Imu, "/imu", print, QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE))
sys.stdout.write("ready\n")
sys.stdout.flush()
signal.pause()
