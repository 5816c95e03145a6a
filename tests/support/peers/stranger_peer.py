"""A node that asks for /scan reliably: a best-effort publisher never matches it."""

from __future__ import annotations

import sys

import rclpy
from sensor_msgs.msg import LaserScan

rclpy.init()
node = rclpy.create_node("stranger")
node.create_subscription(LaserScan, "scan", lambda _: None, 10)
print("ready", flush=True)
sys.stdin.read()
rclpy.try_shutdown()
