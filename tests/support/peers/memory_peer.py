"""An independent node: `types` publishes every message type of packages, latched; `stream` publishes counters at a
rate, `witness` writes down when they arrive, `listen` collects numbers. Each ends when its stdin does."""

from __future__ import annotations

import importlib
import json
import random
import struct
import sys
import threading
import time
from contextlib import suppress

import rclpy
from geometry_msgs.msg import Twist
from rclpy.executors import ExternalShutdownException
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from rosidl_parser.definition import AbstractGenericString, AbstractSequence, Array, NamespacedType
from std_msgs.msg import Int32, UInt8MultiArray
from test_msgs.message_fixtures import get_test_msg


def types(node, *packages: str) -> None:
    latched = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    for package in packages:
        module = importlib.import_module(f"{package}.msg")
        for name in sorted(name for name in dir(module) if name[0].isupper()):
            kind = getattr(module, name)
            publisher = node.create_publisher(kind, f"/t/{package}/{name}", latched)
            node.create_publisher(kind, f"/u/{package}/{name}", latched)
            made = get_test_msg(name) if package == "test_msgs" else []
            for message in [*made, kind(), *(filled(kind, random.Random(f"{name}{i}")) for i in range(2))]:
                publisher.publish(message)
    print("ready", flush=True)
    sys.stdin.read()


def filled(kind, chance: random.Random):
    """A message with a value in every field."""
    message = kind()
    for name, slot in zip(kind.get_fields_and_field_types(), kind.SLOT_TYPES, strict=True):
        setattr(message, name, value_of(slot, chance))
    return message


def value_of(slot, chance: random.Random):
    if isinstance(slot, Array):
        return list_of(slot, slot.size, chance)
    if isinstance(slot, AbstractSequence):
        return list_of(slot, chance.randint(1, getattr(slot, "maximum_size", 3)), chance)
    if isinstance(slot, NamespacedType):
        return filled(getattr(importlib.import_module(".".join(slot.namespaces)), slot.name), chance)
    if isinstance(slot, AbstractGenericString):
        return "".join(chance.choices("ab\u00e4", k=min(5, getattr(slot, "maximum_size", 5) or 5)))
    if slot.typename in ("float", "double"):
        return chance.randint(-1000, 1000) / 8
    if slot.typename == "boolean":
        return chance.random() < 0.5
    if slot.typename == "octet":
        return bytes([chance.randrange(256)])
    bits = int(slot.typename.lstrip("uint") or 8)
    least = 0 if slot.typename.startswith("u") else -(2 ** (bits - 1))
    return least + chance.randrange(2**bits)


def list_of(slot, count: int, chance: random.Random) -> list:
    return [value_of(slot.value_type, chance) for _ in range(count)]


def stream(node, *topics: str) -> None:
    """Each topic is `name:hertz:bytes`; every message holds its number."""
    plan = []
    for topic in topics:
        name, rate, size = topic.split(":")
        publisher = node.create_publisher(UInt8MultiArray, name, 100)
        body = serialize_message(UInt8MultiArray(data=bytes(int(size))))
        plan.append([publisher, 1.0 / float(rate), body, 0, time.monotonic()])
    print("ready", flush=True)
    ending = threading.Thread(target=sys.stdin.read, daemon=True)
    ending.start()
    while ending.is_alive():
        for entry in plan:
            publisher, period, body, number, due = entry
            if time.monotonic() >= due:
                publisher.publish(body[:16] + struct.pack("<Q", number) + body[24:])
                entry[3:5] = [number + 1, due + period]
        time.sleep(max(0.0, min(entry[4] for entry in plan) - time.monotonic()))


def listen(node, *topics: str) -> None:
    """Collects numbers with their times of receipt; a line on stdin asks for them. It publishes on /live too, and
    listens to /cmd_vel."""
    heard: dict[str, list] = {topic: [] for topic in topics}
    for topic in topics:
        node.create_subscription(Int32, topic, lambda m, t=topic: heard[t].append([m.data, time.monotonic()]), 100)
    node.create_publisher(Int32, "/live", 10)
    node.create_subscription(Twist, "/cmd_vel", lambda _: None, 10)

    def spin() -> None:
        with suppress(ExternalShutdownException):
            rclpy.spin(node)

    spinning = threading.Thread(target=spin, daemon=True)
    spinning.start()
    print("ready", flush=True)
    for line in sys.stdin:
        print(json.dumps(heard), flush=True)
        if line.strip() == "forget":
            for numbers in heard.values():
                numbers.clear()
    rclpy.try_shutdown()
    spinning.join()  # a node that is spun to the end of the process does not leave ROS


def witness(node, log: str, *topics: str) -> None:
    """Writes down when it received which message of `stream`, one in a line."""
    with open(log, "w", buffering=1) as lines:  # noqa: PTH123

        def note(data: bytes, topic: str) -> None:
            lines.write(f"{topic} {struct.unpack_from('<Q', data, 16)[0]} {time.time()}\n")

        for topic in topics:
            node.create_subscription(UInt8MultiArray, topic, lambda data, t=topic: note(data, t), 100, raw=True)
        print("ready", flush=True)
        ending = threading.Thread(target=sys.stdin.read, daemon=True)
        ending.start()
        while ending.is_alive():
            rclpy.spin_once(node, timeout_sec=0.1)


if __name__ == "__main__":
    rclpy.init()
    roles = {"types": types, "stream": stream, "listen": listen, "witness": witness}
    node = rclpy.create_node("memory_peer")
    roles[sys.argv[1]](node, *sys.argv[2:])
    node.destroy_node()
    rclpy.try_shutdown()  # killed instead, it would hold up the shared memory of those that come after it
