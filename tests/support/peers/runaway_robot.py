"""A robot that may run away: one JSON list per line in, one JSON value per line out.

It drives along x as it is commanded, tells its speed and its place, and brakes as hard as it can where it is told to
stand. What is wrong with it is commanded too. It knows ROS 2 and nothing of this project. Times: monotonic, in s.
"""

from __future__ import annotations

import json
import math
import sys
import threading
import time

import rclpy
from geometry_msgs.msg import PoseStamped, Twist, TwistStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

STEP_S = 0.01
ODOMETRY_EVERY, PLACE_EVERY = 2, 10
"""Steps: 50 Hz, and 10 Hz as a localization tells it."""
BRAKE_MPS2 = 1.0
ACCELERATION_MPS2 = 2.0
TOO_MUCH_MPS = 3.0
FAULT_AFTER_S = 2.5
"""From full speed on: by then a subscriber that discovers late has heard it."""


class Robot:
    """Its public methods are the commands."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._odom = self._pose = self._commands = None
        self._lock = threading.Lock()
        self.put(base="", fault="")
        threading.Thread(target=self._drive, daemon=True).start()

    def put(self, base: str, fault: str, x: float = 0.0) -> None:
        """At rest at a place, with topics below `base` and a fault that begins only when it is at full speed.

        Faults: `ignores` zeros, is `silent`, tells `nan`, tells `too much`; "" for none.
        """
        with self._lock:
            self._fault, self._x, self._speed, self._wanted = fault, x, 0.0, 0.0
            self._farthest, self._zero_at, self._full_at, self._fault_at = x, 0.0, 0.0, 0.0
            self._stood_s = 0.0
            self._moved = False
            if base:
                self._join(base)

    def _join(self, base: str) -> None:
        for old in (self._odom, self._pose):
            if old:
                self._node.destroy_publisher(old)
        if self._commands:
            self._node.destroy_subscription(self._commands)
        self._odom = self._node.create_publisher(TwistStamped, f"{base}/odom", 10)
        self._pose = self._node.create_publisher(PoseStamped, f"{base}/pose", 10)
        self._commands = self._node.create_subscription(Twist, f"{base}/cmd_vel", self._on_command, 10)

    def listeners(self) -> int:
        """How many subscribers the less heard of its two topics has."""
        return min(topic.get_subscription_count() for topic in (self._odom, self._pose))

    def state(self) -> dict[str, float]:
        """Where it is, how fast, how far it has been, when its first zero after moving came, and its fault began;
        and for how long this process was held up at most, in which it told nothing.
        """
        with self._lock:
            return {
                "x": self._x, "speed": self._speed, "farthest": self._farthest, "zero_at": self._zero_at,
                "fault_at": self._fault_at, "full_at": self._full_at, "stood_s": self._stood_s,
            }  # fmt: skip

    def _on_command(self, command: Twist) -> None:
        with self._lock:
            if command.linear.x:
                self._moved, self._zero_at = True, 0.0
            elif self._moved and not self._zero_at:
                self._zero_at = time.monotonic()
            if command.linear.x or self._fault != "ignores":
                self._wanted = command.linear.x

    def _drive(self) -> None:
        step, due = 0, time.monotonic()
        while True:
            due, step = due + STEP_S, step + 1
            time.sleep(max(0.0, due - time.monotonic()))
            with self._lock:
                self._stood_s = max(self._stood_s, time.monotonic() - due)
                self._move()
                self._tell(step)

    def _move(self) -> None:
        most = (BRAKE_MPS2 if abs(self._wanted) < abs(self._speed) else ACCELERATION_MPS2) * STEP_S
        self._speed += max(-most, min(most, self._wanted - self._speed))
        self._x += self._speed * STEP_S
        self._farthest = max(self._farthest, self._x)
        if self._wanted and self._speed == self._wanted and not self._full_at:
            self._full_at = time.monotonic()
        if self._full_at and not self._fault_at and time.monotonic() > self._full_at + FAULT_AFTER_S:
            self._fault_at = time.monotonic()

    def _tell(self, step: int) -> None:
        told = self._told()
        if self._odom and step % ODOMETRY_EVERY == 0 and told is not None:
            message = TwistStamped()
            message.twist.linear.x = told
            self._odom.publish(message)
        if self._pose and step % PLACE_EVERY == 0:
            place = PoseStamped()
            place.header.frame_id, place.pose.position.x, place.pose.orientation.w = "map", self._x, 1.0
            self._pose.publish(place)

    def _told(self) -> float | None:
        if not self._fault_at or self._fault in ("", "ignores"):
            return self._speed
        return {"silent": None, "nan": math.nan, "too much": TOO_MUCH_MPS}[self._fault]


def main() -> None:
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = Node("runaway_robot")
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
