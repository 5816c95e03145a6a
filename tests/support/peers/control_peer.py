"""A base and an arm under controllers like those of ros2_control: a JSON list per line in, a JSON value per line out.

Its publishers are transient_local with a depth of 1, as SystemDefaultsQoS is under Fast DDS, and its subscription to
velocities is best effort. The base keeps its last commanded speed, like wheels without a time-out: whether its
controllers are inactive, silent or gone, or killed or frozen with this process, does not change how the body moves. It
knows ROS 2 and nothing of this project. Times: monotonic, in s.
"""

from __future__ import annotations

import json
import math
import sys
import threading
import time
from typing import Any

import rclpy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

STEP_S = 0.01
ODOMETRY_EVERY, JOINTS_EVERY = 2, 1
"""Steps: 50 Hz, and 100 Hz."""
WHEEL_M = 0.1
LATCHED = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
BEST_EFFORT = QoSProfile(depth=1, reliability=QoSReliabilityPolicy.BEST_EFFORT)


class Robot:
    """Its public methods are the commands."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._node: Node | None = None
        self._context = rclpy.Context()
        self._executor: SingleThreadedExecutor | None = None
        self._odometry: Any = None
        self._joints: Any = None
        self._speed = self._joint_speed = self._x = self._wheel = self._joint = self._climb = self._z = 0.0
        self._is_active = True
        self._kept: Odometry | None = None
        self._zeros = self._moves = 0
        threading.Thread(target=self._live, daemon=True).start()

    def put(self, base: str, *, odometry: bool = True, joints: bool = True, arm: bool = False) -> None:
        """At rest, under controllers with topics below `base`; that of an `arm` takes trajectories."""
        self.leave()
        # A participant of its own each time, as of a process that is started again: while two nodes of one participant
        # have the same name, ROS mixes up their endpoints.
        self._context = rclpy.Context()
        rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self._executor = SingleThreadedExecutor(context=self._context)
        node = Node(base.strip("/").replace("/", "_"), context=self._context)
        with self._lock:
            self._speed = self._joint_speed = self._climb = 0.0
            self._is_active, self._kept, self._zeros, self._moves = True, None, 0, 0
            self._odometry = node.create_publisher(Odometry, f"{base}/odom", LATCHED) if odometry else None
            self._joints = node.create_publisher(JointState, f"{base}/joint_states", LATCHED) if joints else None
            node.create_subscription(Twist, f"{base}/cmd_vel", self._on_command, BEST_EFFORT)
            if arm:
                node.create_subscription(JointTrajectory, f"{base}/arm/joint_trajectory", lambda _: None, 1)
            node.create_service(Trigger, f"{base}/beep", lambda _, answer: answer)
            self._node = node
        self._executor.add_node(node)
        threading.Thread(target=self._executor.spin, daemon=True).start()

    def leave(self) -> None:
        """The controllers leave the graph; the body goes on."""
        node = self._node
        with self._lock:
            self._node = self._odometry = self._joints = None
        if node and self._executor:
            self._executor.shutdown()
            node.destroy_node()
            self._context.try_shutdown()

    def deactivate(self) -> None:
        """The base's controller is inactive from now on: its last odometry stays with its publisher."""
        with self._lock:
            self._is_active = False

    def push(self, speed: float = 0.0, joint_speed: float = 0.0, climb: float = 0.0) -> None:
        """Somebody else moves base (m/s along x, and upwards) and arm (rad/s), but not through the topics here."""
        with self._lock:
            self._speed, self._joint_speed, self._climb = speed, joint_speed, climb

    def repeat_last(self) -> None:
        """The driver publishes its last odometry again and again, as one does that has lost its hardware."""
        with self._lock:
            self._kept = self._odometry_message()

    def state(self) -> dict[str, float]:
        """How fast the body is now, by the truth, how many zeros came, and how many commands that move."""
        with self._lock:
            return {
                "speed": math.hypot(self._speed, self._climb) + abs(self._joint_speed),
                "zeros": self._zeros,
                "moves": self._moves,
            }

    def listeners(self) -> int:
        """How many subscribers the less heard of its publishers has."""
        return min(one.get_subscription_count() for one in (self._odometry, self._joints) if one)

    def _on_command(self, command: Twist) -> None:
        with self._lock:
            if self._is_active:
                self._speed = command.linear.x
            self._moves += bool(command.linear.x)
            self._zeros += not command.linear.x

    def _live(self) -> None:
        step, due = 0, time.monotonic()
        while True:
            due, step = due + STEP_S, step + 1
            time.sleep(max(0.0, due - time.monotonic()))
            with self._lock:
                self._x += self._speed * STEP_S
                self._z += self._climb * STEP_S
                self._wheel += self._speed * STEP_S / WHEEL_M
                self._joint += self._joint_speed * STEP_S
                if self._odometry and self._is_active and step % ODOMETRY_EVERY == 0:
                    self._odometry.publish(self._kept or self._odometry_message())
                if self._joints and step % JOINTS_EVERY == 0:
                    message = JointState(name=["wheel", "shoulder"], position=[self._wheel, self._joint])
                    message.header.stamp = self._now()
                    self._joints.publish(message)

    def _odometry_message(self) -> Odometry:
        message = Odometry(child_frame_id="base_link")
        message.header.frame_id, message.header.stamp = "odom", self._now()
        message.pose.pose.position.x, message.pose.pose.position.z = self._x, self._z
        message.pose.pose.orientation.w = 1.0
        message.twist.twist.linear.x, message.twist.twist.linear.z = self._speed, self._climb
        return message

    def _now(self) -> Any:
        return self._node.get_clock().now().to_msg()


def main() -> None:
    robot = Robot()
    print('"ready"', flush=True)
    for line in sys.stdin:
        command, arguments = json.loads(line)
        print(json.dumps(getattr(robot, command)(**arguments)), flush=True)


if __name__ == "__main__":
    main()
