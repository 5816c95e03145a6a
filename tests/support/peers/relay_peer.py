"""Independent rclpy nodes for the tests of relays: `relay_peer.py ROLE ...` says when it has met the others."""

from __future__ import annotations

import json
import os
import sys
import threading
import time

import rclpy
import rclpy.executors
from geometry_msgs.msg import Twist
from rclpy.node import Node
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, String

from support.leaving import leave_on_sigterm

KINDS = {"String": String, "Twist": Twist, "JointState": JointState, "Float64": Float64}


def say(value: object) -> None:
    sys.stdout.write(json.dumps(value) + "\n")
    sys.stdout.flush()


def profile(reliability: str, durability: str = "VOLATILE") -> QoSProfile:
    return QoSProfile(
        depth=5000,
        reliability=QoSReliabilityPolicy[reliability],
        durability=QoSDurabilityPolicy[durability],
    )


def message(kind: str, number: int) -> object:
    """The message of a number; of JointState, the position changes at every tenth only, while the stamp always does."""
    if kind == "String":
        return String(data=str(number))
    if kind == "Twist":
        found = Twist()
        found.linear.x = float(number)
        return found
    found = JointState(name=["arm"], position=[number // 10 + 0.001 * (number % 10)], velocity=[float("nan")])
    found.header.stamp.sec, found.header.frame_id = number, "base"
    return found


def number_in(kind: str, data: bytes) -> float:
    """What `message` put in."""
    found = deserialize_message(data, KINDS[kind])
    if kind == "JointState":
        return found.header.stamp.sec
    return found.linear.x if kind == "Twist" else float(found.data)


def talk(node: Node, topic: str, kind: str, reliability: str, rate_hz: str, count: str, subscribers: str = "1") -> None:
    """Wait for subscribers and a line on stdin, publish so many messages at the rate, say how many, stay."""
    publisher = node.create_publisher(KINDS[kind], topic, profile(reliability))
    while publisher.get_subscription_count() < int(subscribers):
        time.sleep(0.005)
    say("ready")
    sys.stdin.readline()
    started = time.monotonic()
    for number in range(int(count)):
        time.sleep(max(0.0, started + number / float(rate_hz) - time.monotonic()))
        publisher.publish(message(kind, number))
    say(int(count))


def talk_later(node: Node, *arguments: str) -> None:
    """Be known as a participant, and `talk` from a line on stdin on."""
    sys.stdin.readline()
    talk(node, *arguments)


def listen(node: Node, topic: str, kind: str, reliability: str) -> None:
    """Once there is a publisher, at each line on stdin say the numbers and when they came, and forget them."""
    taken: list[tuple[float, bytes]] = []
    subscription = node.create_subscription(
        KINDS[kind], topic, lambda data: taken.append((time.monotonic(), data)), profile(reliability), raw=True
    )
    executor = rclpy.executors.SingleThreadedExecutor()
    executor.add_node(node)
    threading.Thread(target=executor.spin, daemon=True).start()
    while subscription.get_publisher_count() < 1:
        time.sleep(0.005)
    say("ready")
    for _ in sys.stdin:
        now = list(taken)
        del taken[: len(now)]
        say([[round(at, 4), number_in(kind, data)] for at, data in now])


def complain(node: Node, count: str) -> None:
    """Log so many warnings and one error, say so; then one error for each line on stdin."""
    for number in range(int(count)):
        node.get_logger().warning(f"number {number}")
    node.get_logger().error("the arm is stuck")
    say("ready")
    for line in sys.stdin:
        node.get_logger().error(line.strip())


def main() -> None:
    role, *arguments = sys.argv[1:]
    rclpy.init()
    leave_on_sigterm()
    node = Node(f"relay_peer_{role}_{os.getpid()}")
    {"talk": talk, "talk_later": talk_later, "listen": listen, "complain": complain}[role](node, *arguments)
    while True:
        time.sleep(1.0)


if __name__ == "__main__":
    main()
