"""`python -m bench.twelve`: a robot with twelve planted situations, for the tasks of twelve.md.

It ends with its standard input. For each line on standard input it prints its state, and what was done with it, as
JSON.
"""

from __future__ import annotations

import array
import json
import math
import random
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

import rclpy
from geometry_msgs.msg import PoseStamped, Twist
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import BatteryState, Imu, JointState, LaserScan, Range, Temperature
from std_msgs.msg import Bool, Float64
from std_srvs.srv import SetBool

STEP_S = 0.01
MEAN_C, STD_C = 61.3, 0.4
DRIFT_M_PER_MIN = 0.24
DOOR_S = 3.0
WALL_M = 2.0
JOINT, JOINT_HZ, JOINT_RAD = 3, 0.5, 0.35
TAG_M = (1.25, -0.40)
LATE_S = 0.08
CHARGE = 0.37
ERROR_EVERY_S = 15.0
SLOW_SCAN = 20
"""Steps between two scans: 5 Hz, where 8 Hz are expected."""
COMMANDS_LAST_S = 0.5


class Robot:
    """All situations in one node; times are of the monotonic clock, in s."""

    def __init__(self, node: Node) -> None:
        self.node = node
        self.began = time.monotonic()
        self.noise = random.Random(15)
        self.x = self.y = self.yaw = self.speed = self.turning = 0.0
        self.commanded = self.error_at = self.lamp_at = 0.0
        self.nearest_m = WALL_M
        self.furthest_m = 0.0
        self.sends: dict[str, Callable[[Any], None]] = {}
        node.create_subscription(Twist, "/cmd_vel", self.on_command, 10)
        node.create_service(SetBool, "/lamp/set", self.on_lamp)

    def send(self, topic: str, message: Any) -> None:
        """Publish a message, with a stamp if it has a header."""
        if topic not in self.sends:
            self.sends[topic] = self.node.create_publisher(type(message), topic, 10).publish
        if hasattr(message, "header"):
            message.header.stamp = self.node.get_clock().now().to_msg()
        self.sends[topic](message)

    def on_command(self, command: Twist) -> None:
        self.commanded = time.monotonic()
        self.speed, self.turning = command.linear.x, command.angular.z

    def on_lamp(self, request: Any, response: Any) -> Any:
        self.lamp_at = time.monotonic() if request.data else 0.0
        response.success, response.message = True, "the lamp is on" if request.data else "the lamp is off"
        return response

    def truth(self) -> dict[str, Any]:
        return {
            "x": self.x,
            "yaw_deg": math.degrees(self.yaw),
            "stands": not self.speed and not self.turning,
            "nearest_m": self.nearest_m,
            "furthest_m": self.furthest_m,
            "lamp_after_error_s": self.lamp_at - self.error_at if self.lamp_at > self.error_at else None,
            "now_s": time.monotonic() - self.began,
        }

    def step(self, number: int) -> None:
        now = time.monotonic() - self.began
        if time.monotonic() - self.commanded > COMMANDS_LAST_S:
            self.speed = self.turning = 0.0
        self.yaw += self.turning * STEP_S
        moved = self.speed * math.cos(self.yaw) * STEP_S
        self.x, self.y = self.x + moved, self.y + self.speed * math.sin(self.yaw) * STEP_S
        self.nearest_m = min(self.nearest_m, WALL_M - self.x)
        self.furthest_m = max(self.furthest_m, self.x)
        if number % 2 == 0:
            self.tell_imu(now)
        if number % 4 == 0:
            self.tell_odometry()
        if number % 5 == 0:
            self.tell_slow(now)
        if number % SLOW_SCAN == 0:
            self.tell_scan()
        if number % int(ERROR_EVERY_S / STEP_S) == 0 and number:
            self.node.get_logger().error("pump: pressure lost in line 2")
            self.error_at = time.monotonic()

    def tell_imu(self, now: float) -> None:
        for topic, late_s in (("/imu/a", 0.0), ("/imu/b", LATE_S)):
            message = Imu()
            at = now - late_s
            message.angular_velocity.z = math.sin(1.7 * at) + 0.5 * math.sin(4.3 * at) + self.noise.gauss(0.0, 0.01)
            self.send(topic, message)

    def tell_odometry(self) -> None:
        message = Odometry(child_frame_id="base_link")
        message.header.frame_id = "odom"
        message.pose.pose.position.x, message.pose.pose.position.y = self.x, self.y
        turned = message.pose.pose.orientation
        turned.z, turned.w = math.sin(self.yaw / 2), math.cos(self.yaw / 2)
        message.twist.twist.linear.x, message.twist.twist.angular.z = self.speed, self.turning
        self.send("/odom", message)
        seen = PoseStamped()
        seen.header.frame_id = "base_link"
        seen.pose.position.x = TAG_M[0] + self.noise.gauss(0.0, 0.05)
        seen.pose.position.y = TAG_M[1] + self.noise.gauss(0.0, 0.05)
        seen.pose.orientation.w = 1.0
        self.send("/tag/pose", seen)

    def tell_slow(self, now: float) -> None:
        number = self.noise.random()
        warm = math.nan if number < 0.05 else self.noise.gauss(MEAN_C, STD_C)
        self.send("/boiler/temperature", Temperature(temperature=warm))
        for place, side in enumerate(("front", "left", "rear", "right")):
            drift = DRIFT_M_PER_MIN * now / 60 if side == "rear" else 0.0
            message = Range(min_range=0.02, max_range=10.0)
            message.range = 1.0 + 0.1 * place + drift + self.noise.gauss(0.0, 0.01)
            self.send(f"/range/{side}", message)
        self.send("/door", Bool(data=now % DOOR_S > DOOR_S / 2))
        self.send("/heading", Float64(data=math.degrees(self.yaw) % 360.0))
        angles = [0.1 * joint for joint in range(6)]
        angles[JOINT] += JOINT_RAD * math.sin(2 * math.pi * JOINT_HZ * now)
        names = [f"joint_{joint + 1}" for joint in range(6)]
        self.send("/joint_states", JointState(name=names, position=angles))
        self.send("/battery", BatteryState(percentage=CHARGE, present=True))
        self.send("/estop", Bool(data=False))

    def tell_scan(self) -> None:
        """Publish a scan: a wall ahead, a corridor open at 130° on the left, walls at 1 m elsewhere."""
        message = LaserScan(angle_min=-math.pi, angle_max=math.pi, angle_increment=math.tau / 360)
        message.header.frame_id = "base_link"
        message.range_min, message.range_max = 0.05, 12.0
        ranges = [1.0 + self.noise.gauss(0.0, 0.01)] * 361
        for degree in range(-20, 21):
            ranges[degree + 180] = max(WALL_M - self.x, 0.06) / math.cos(math.radians(degree))
        for degree in range(120, 141):
            ranges[degree + 180] = 6.0
        message.ranges = array.array("f", ranges)
        self.send("/scan", message)


def live(robot: Robot) -> None:
    number, due = 0, time.monotonic()
    while True:
        due, number = due + STEP_S, number + 1
        time.sleep(max(0.0, due - time.monotonic()))
        robot.step(number)


def main() -> None:
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = Node("twelve")
    robot = Robot(node)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    for work in (executor.spin, lambda: live(robot)):
        threading.Thread(target=work, daemon=True).start()
    print("ready", flush=True)
    for _ in sys.stdin:
        print(json.dumps(robot.truth()), flush=True)


if __name__ == "__main__":
    main()
