"""A node that asks for /scan reliably: a best-effort publisher never matches it. Topics that are named it publishes."""

from __future__ import annotations

import sys

import rclpy
from sensor_msgs.msg import LaserScan, Range

rclpy.init()
node = rclpy.create_node("stranger")
node.create_subscription(LaserScan, "scan", lambda _: None, 10)
publishers = [node.create_publisher(Range, topic, 10) for topic in sys.argv[1:]]
print("ready", flush=True)
sys.stdin.read()
rclpy.try_shutdown()
