"""Nodes that a robot would rather not have: `faulty_peer.py ROLE ARGUMENT...`."""

from __future__ import annotations

import importlib
import json
import os
import sys
import threading
import time
from array import array

import rclpy
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy
from rclpy.serialization import serialize_message
from std_msgs.msg import UInt8MultiArray, UInt64

from support.leaving import leave_on_sigterm


def repeat(node: Node, topic: str, kind: str, rate_hz: str) -> None:
    """Publish an empty message again and again."""
    package, name = kind.split("/msg/")
    message = getattr(importlib.import_module(f"{package}.msg"), name)()
    publisher = node.create_publisher(type(message), topic, 10)
    node.create_timer(1 / float(rate_hz), lambda: publisher.publish(message))


def endpoints(node: Node, side: str, topics: str) -> None:
    """Publishers or subscriptions of UInt64: JSON, topic → policies."""
    for topic, given in json.loads(topics).items():
        profile = QoSProfile(
            depth=10,
            reliability=QoSReliabilityPolicy[given.get("reliability", "RELIABLE")],
            durability=QoSDurabilityPolicy[given.get("durability", "VOLATILE")],
            deadline=Duration(nanoseconds=given.get("deadline_ns", 0)),
        )
        if side == "publishers":
            node.create_publisher(UInt64, topic, profile)
        else:
            node.create_subscription(UInt64, topic, lambda _: None, profile)


def flood(node: Node, topic: str, rate_hz: str, count: str, size: str) -> None:
    """As soon as there is a subscriber: messages numbered in their first four bytes, then a line with their count.

    Whoever subscribes must have discovered the topic before, for then the publisher is the last to learn of the match.
    """
    publisher = node.create_publisher(UInt8MultiArray, topic, QoSProfile(depth=1000))
    threading.Thread(target=_flood, args=(publisher, float(rate_hz), int(count), int(size)), daemon=True).start()


def _flood(publisher: object, rate_hz: float, count: int, size: int) -> None:
    while not publisher.get_subscription_count():  # type: ignore[attr-defined]
        time.sleep(0.01)
    empty = bytearray(serialize_message(UInt8MultiArray(data=array("B", bytes(size)))))
    begin = empty.index(size.to_bytes(4, "little")) + 4
    started, sent = time.monotonic(), 0
    while sent < count:
        due = min(count, int((time.monotonic() - started) * rate_hz))
        for number in range(sent, due):
            empty[begin : begin + 4] = number.to_bytes(4, "big")
            publisher.publish(bytes(empty))  # type: ignore[attr-defined]
        sent = due
        time.sleep(0.001)
    sys.stdout.write(f"{count}\n")
    sys.stdout.flush()


def main() -> None:
    role, *arguments = sys.argv[1:]
    rclpy.init()
    told_to_end = threading.Event()
    leave_on_sigterm(told_to_end.set)
    # A node that describes its types (from Jazzy on) can be read without their package.
    undescribed = Parameter("start_type_description_service", value=False)
    overrides = [undescribed] if os.environ.get("DESCRIBES_NO_TYPES") else []
    node = Node(f"{role}_{os.getpid()}", parameter_overrides=overrides)
    globals()[role](node, *arguments)
    while not told_to_end.is_set():
        rclpy.spin_once(node, timeout_sec=0.1)
    node.destroy_node()
    rclpy.try_shutdown()
    os._exit(0)  # a daemon thread may still use what has just been destroyed


if __name__ == "__main__":
    main()
