"""A robot with the simulated physics of `support/physics.py`: one JSON list per line in, one JSON value per line out.

It follows velocity commands, tells odometry and a scan, both in the frame of its base. Times: monotonic, in s.
"""

from __future__ import annotations

import array
import json
import math
import struct
import sys
import threading
import time
from typing import Any

import rclpy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, qos_profile_sensor_data
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import LaserScan, PointCloud2, PointField
from std_msgs.msg import Float64, String

from support.physics import RADIUS_M, STEP_S, Base, Disc, scan_message

ODOMETRY_EVERY, SCAN_EVERY = 4, 10
"""Steps: 25 Hz, and 10 Hz."""
DESCRIPTION = f"""<robot name="round"><link name="base_link"><collision><geometry>
<cylinder radius="{RADIUS_M}" length="0.2"/></geometry></collision></link></robot>"""
COMMANDS_LAST_S = 0.5
"""Without a new command it stops by itself, as the drivers of most bases do."""


class Robot:
    """Its public methods are the commands."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._lock = threading.Lock()
        self._base, self._discs, self._silent = Base(), list[Disc](), ""
        self._commanded_at = self._moved_at = self._odometry_at = self._scan_at = self._stood_s = 0.0
        self._odometry: Any = None
        self._sensors: dict[str, Any] = {}
        self._commands: Any = None
        self._description: Any = None
        self._kept: Any = None
        self._nearest = math.inf
        self._collisions = 0
        self._near_m = self._near_at = self._zero_at = 0.0
        threading.Thread(target=self._live, daemon=True).start()

    def put(
        self,
        base: str,
        discs: list[list[float]] = [],  # noqa: B006 - from JSON
        sees: str = "scan",
        **physics: float,
    ) -> None:
        """At the origin, with topics below `base`, obstacles (x, y, radius, vx, vy), and this physics. It `sees` by a
        `scan` all around, by a `cloud` of what is ahead, by `two` scanners that each see one half, or not at all ("").
        """
        with self._lock:
            self._base, self._discs = Base(**physics), [Disc(*disc) for disc in discs]  # pyright: ignore[reportArgumentType]
            self._silent, self._nearest, self._moved_at, self._stood_s = "", math.inf, 0.0, 0.0
            self._collisions, self._zero_at = 0, 0.0
            for old in (self._odometry, *self._sensors.values(), self._description):
                if old:
                    self._node.destroy_publisher(old)
            if self._commands:
                self._node.destroy_subscription(self._commands)
            self._odometry = self._node.create_publisher(Odometry, f"{base}/odom", 10)
            kinds = {"scan": ["scan"], "cloud": ["points"], "two": ["front", "rear"], "": []}[sees]
            self._sensors = {
                name: self._node.create_publisher(
                    PointCloud2 if name == "points" else LaserScan, f"{base}/{name}", qos_profile_sensor_data
                )
                for name in kinds
            }
            latched = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
            self._description = self._node.create_publisher(String, f"{base}/robot_description", latched)
            self._description.publish(String(data=DESCRIPTION))
            self._commands = self._node.create_subscription(Twist, f"{base}/cmd_vel", self._on_command, 10)

    def keep(self, topic: str, values: list[float]) -> None:
        """Publish numbers, which are kept for late subscribers, on a topic."""
        latched = QoSProfile(depth=len(values), durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
        self._kept = self._node.create_publisher(Float64, topic, latched)
        for value in values:
            self._kept.publish(Float64(data=value))

    def limit(self, name: str, value: float) -> None:
        """A parameter of this node, as drivers have them for their limits; it follows none."""
        if not self._node.has_parameter(name):
            self._node.declare_parameter(name, value)
        self._node.set_parameters([Parameter(name, value=value)])

    def note_near(self, range_m: float) -> None:
        """Note when the first scan leaves that has a range below this one; `near_at` of the state."""
        with self._lock:
            self._near_m, self._near_at = range_m, 0.0

    def silence(self, topic: str) -> None:
        """`odom` or `scan` tells nothing more."""
        with self._lock:
            self._silent = topic

    def state(self) -> dict[str, Any]:
        """Where it is by the truth and by its odometry, how fast, how near it came to something, and for
        how many steps of its time it moved in something; when the last command
        that moves came, and the first zero after it; when it last told odometry and scan, and the first scan below
        `note_near`; how long this process was held up at most.
        """
        with self._lock:
            base = self._base
            return {
                "truth": [base.x, base.y, base.yaw],
                "odometry": base.odometry,
                "speed": math.hypot(base.linear, base.angular),
                "nearest": self._nearest if math.isfinite(self._nearest) else None,
                "collisions": self._collisions,
                "moved_at": self._moved_at,
                "odom_at": self._odometry_at,
                "scan_at": self._scan_at,
                "zero_at": self._zero_at,
                "near_at": self._near_at,
                "stood_s": self._stood_s,
            }

    def _on_command(self, command: Twist) -> None:
        now = time.monotonic()
        with self._lock:
            self._commanded_at = now
            if command.linear.x or command.angular.z:
                self._moved_at, self._zero_at = now, 0.0
            elif not self._zero_at:
                self._zero_at = now
            self._base.command(now, command.linear.x, command.angular.z)

    def _live(self) -> None:
        step, due = 0, time.monotonic()
        while True:
            due, step = due + STEP_S, step + 1
            time.sleep(max(0.0, due - time.monotonic()))
            with self._lock:
                now = time.monotonic()
                self._stood_s = max(self._stood_s, now - due)
                if now - self._commanded_at > COMMANDS_LAST_S:
                    self._base.command(now, 0.0, 0.0)
                self._base.step(now)
                for disc in self._discs:
                    gap = math.hypot(disc.x - self._base.x, disc.y - self._base.y) - disc.radius - RADIUS_M
                    self._nearest = min(self._nearest, gap)
                    self._collisions += disc.hits(self._base)
                    disc.step(self._base)
                self._tell(step, now)

    def _tell(self, step: int, now: float) -> None:
        stamp = self._node.get_clock().now().to_msg()
        if self._odometry and step % ODOMETRY_EVERY == 0 and self._silent != "odom":
            message = Odometry(child_frame_id="base_link")
            message.header.frame_id, message.header.stamp = "odom", stamp
            told = self._base.odometry_message().pose.pose
            message.pose.pose.position.x, message.pose.pose.position.y = told.position.x, told.position.y
            message.pose.pose.orientation.z, message.pose.pose.orientation.w = told.orientation.z, told.orientation.w
            self._odometry.publish(message)
            self._odometry_at = now
        if self._sensors and step % SCAN_EVERY == 0 and self._silent != "scan":
            seen = scan_message(self._base, self._discs, beams=120, noise_m=0.005)
            for name, publisher in self._sensors.items():
                publisher.publish(self._cloud(seen, stamp) if name == "points" else self._scan(seen, name, stamp))
            self._scan_at = now

    def _scan(self, seen: Any, name: str, stamp: Any) -> LaserScan:
        """What the scanner of that name sees: all around, or of two its half alone."""
        ranges, begin = array.array("f", seen.ranges), seen.angle_min
        quarter = len(ranges) // 4
        if name == "front":
            ranges, begin = ranges[quarter : 3 * quarter + 1], -math.pi / 2
        elif name == "rear":
            ranges, begin = ranges[3 * quarter :] + ranges[: quarter + 1], math.pi / 2
        message = LaserScan(angle_min=begin, angle_increment=seen.angle_increment)
        message.angle_max = begin + (len(ranges) - 1) * seen.angle_increment
        message.header.frame_id, message.header.stamp = "base_link", stamp
        message.range_min, message.range_max, message.ranges = seen.range_min, seen.range_max, ranges
        if not self._near_at and min(ranges) < self._near_m:
            self._near_at = time.monotonic()
        return message

    @staticmethod
    def _cloud(seen: Any, stamp: Any) -> PointCloud2:
        """What a camera that looks ahead sees in depth, of 90°: the floor, and upright what the beams meet."""
        points: list[tuple[float, float, float]] = []
        for number, distance in enumerate(seen.ranges):
            angle = seen.angle_min + number * seen.angle_increment
            if abs(angle) < math.pi / 4:
                cosine, sine = math.cos(angle), math.sin(angle)
                points += [
                    (0.1 * step * cosine, 0.1 * step * sine, -0.1) for step in range(3, 20) if 0.1 * step < distance
                ]
                if math.isfinite(distance):
                    points += [(distance * cosine, distance * sine, height / 50) for height in range(6)]
        message = PointCloud2(height=1, width=len(points), point_step=12, row_step=12 * len(points), is_dense=True)
        message.header.frame_id, message.header.stamp = "base_link", stamp
        message.fields = [PointField(name=name, offset=4 * at, datatype=7, count=1) for at, name in enumerate("xyz")]
        message.data = array.array("B", b"".join(struct.pack("<3f", *point) for point in points))
        return message


def main() -> None:
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = Node("driven_robot")
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    robot = Robot(node)
    threading.Thread(target=executor.spin, daemon=True).start()
    print('"ready"', flush=True)
    for line in sys.stdin:
        command, arguments = json.loads(line)
        print(json.dumps(getattr(robot, command)(**arguments)), flush=True)


if __name__ == "__main__":
    main()
