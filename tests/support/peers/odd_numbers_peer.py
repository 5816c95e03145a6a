"""A node whose numbers are not finite: it publishes all of `support.odd_numbers` five times a second.

It listens to /cmd_vel, as a base does.
"""

from __future__ import annotations

import contextlib
import importlib
from collections.abc import Mapping
from typing import Any

import rclpy
from geometry_msgs.msg import Twist
from rclpy.executors import ExternalShutdownException

from support.leaving import leave_on_sigterm
from support.odd_numbers import MESSAGES

PERIOD_S = 0.2


def message_of(kind: str, fields: Mapping[str, Any]) -> Any:
    """A message of that type with these fields."""
    package, _, name = kind.split("/")
    found = getattr(importlib.import_module(f"{package}.msg"), name)()
    fill(found, fields)
    return found


def fill(message: Any, fields: Mapping[str, Any]) -> None:
    """Sets fields of a message, below others too, and messages in lists."""
    kinds = message.get_fields_and_field_types()
    for name, value in fields.items():
        if isinstance(value, Mapping):
            fill(getattr(message, name), value)
        elif isinstance(value, list) and value and isinstance(value[0], Mapping):
            package, one = kinds[name].removeprefix("sequence<").rstrip(">").split("/")
            setattr(message, name, [message_of(f"{package}/msg/{one}", each) for each in value])
        elif kinds[name] == "octet":
            setattr(message, name, bytes([value]))
        else:
            setattr(message, name, value)


def main() -> None:
    rclpy.init()
    leave_on_sigterm()
    node = rclpy.create_node("odd_numbers")
    made = {topic: message_of(kind, fields) for topic, (kind, fields) in MESSAGES.items()}
    publishers = {topic: node.create_publisher(type(message), topic, 10) for topic, message in made.items()}
    node.create_subscription(Twist, "/cmd_vel", lambda _: None, 10)

    def publish() -> None:
        now = node.get_clock().now().to_msg()
        for topic, message in made.items():
            if hasattr(message, "header"):
                message.header.stamp = now
            for one in getattr(message, "transforms", ()):
                one.header.stamp = now
            publishers[topic].publish(message)

    node.create_timer(PERIOD_S, publish)
    print("ready", flush=True)
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node)


main()
