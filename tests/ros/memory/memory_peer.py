"""An independent node: `types` publishes every type of test_msgs, latched; `stream` publishes counters at a rate,
`listen` collects numbers."""

from __future__ import annotations

import json
import struct
import sys
import threading
import time

import rclpy
import test_msgs.msg
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from std_msgs.msg import Int32, UInt8MultiArray
from test_msgs.message_fixtures import get_test_msg

TYPES = sorted(name for name in dir(test_msgs.msg) if name[0].isupper())


def types(node) -> None:
    latched = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    for name in TYPES:
        kind = getattr(test_msgs.msg, name)
        publisher = node.create_publisher(kind, f"/t/{name}", latched)
        node.create_publisher(kind, f"/u/{name}", latched)
        for message in get_test_msg(name) or [kind()]:
            publisher.publish(message)
    print("ready", flush=True)
    time.sleep(600)


def stream(node, *topics: str) -> None:
    """Each topic is `name:hertz:bytes`; every message holds its number."""
    plan = []
    for topic in topics:
        name, rate, size = topic.split(":")
        publisher = node.create_publisher(UInt8MultiArray, name, 100)
        body = serialize_message(UInt8MultiArray(data=bytes(int(size))))
        plan.append([publisher, 1.0 / float(rate), body, 0, time.monotonic()])
    print("ready", flush=True)
    while True:
        for entry in plan:
            publisher, period, body, number, due = entry
            if time.monotonic() >= due:
                publisher.publish(body[:16] + struct.pack("<Q", number) + body[24:])
                entry[3:] = [number + 1, due + period]
        time.sleep(max(0.0, min(entry[4] for entry in plan) - time.monotonic()))


def listen(node, *topics: str) -> None:
    """Collects numbers with their times of receipt; a line on stdin asks for them. It publishes on /live too."""
    heard: dict[str, list] = {topic: [] for topic in topics}
    for topic in topics:
        node.create_subscription(Int32, topic, lambda m, t=topic: heard[t].append([m.data, time.monotonic()]), 100)
    node.create_publisher(Int32, "/live", 10)
    threading.Thread(target=rclpy.spin, args=(node,), daemon=True).start()
    print("ready", flush=True)
    for line in sys.stdin:
        print(json.dumps(heard), flush=True)
        if line.strip() == "forget":
            for numbers in heard.values():
                numbers.clear()


if __name__ == "__main__":
    rclpy.init()
    {"types": types, "stream": stream, "listen": listen}[sys.argv[1]](rclpy.create_node("memory_peer"), *sys.argv[2:])
