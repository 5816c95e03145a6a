"""An independent rclpy node that a test commands: one JSON object per line in, one per line out.

It fills, sends, receives and compares with rclpy alone; only verdicts go back to the test.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy
from rclpy.serialization import deserialize_message

from support import ros_values

PATIENCE_S = 20.0


class Peer:
    """Publishers and subscriptions by topic; its public methods are the commands."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._received: dict[str, list[bytes]] = {}
        self._subscriptions: dict[str, Any] = {}
        self._publishers: dict[str, Any] = {}

    def listen(self, topic: str, kind: str, **profile: bool) -> None:
        """Keep the bytes of every message of the topic."""
        self._received[topic] = []
        keep = self._received[topic].append
        cls = ros_values.message_class(kind)
        self._subscriptions[topic] = self._node.create_subscription(cls, topic, keep, _profile(**profile), raw=True)

    def offer(self, topic: str, kind: str, seed: int, **profile: bool) -> None:
        """Publish the message of the seed."""
        self._publish(topic, kind, ros_values.filled(kind, seed), profile)

    def offer_ramp(self, topic: str, kind: str, field: str, length: int, **profile: bool) -> None:
        """Publish a message with one long array of numbers that tell their place."""
        self._publish(topic, kind, ros_values.with_ramp(kind, field, length), profile)

    def count(self, topic: str, expected: int) -> int:
        """How many messages came, as soon as there are as many as expected."""
        self._wait(topic, expected)
        return len(self._received[topic])

    def compare(self, topic: str, kind: str, seed: int) -> list[str]:
        """How the next message differs from that of the seed: by value, and by bytes without padding."""
        return self._differences(topic, ros_values.filled(kind, seed))

    def compare_ramp(self, topic: str, kind: str, field: str, length: int) -> list[str]:
        """How the next message differs from the one with the long array."""
        return self._differences(topic, ros_values.with_ramp(kind, field, length))

    def readers(self, topic: str, expected: int) -> int:
        """How many subscribers get what is published, as soon as there are as many as expected."""
        publisher = self._publishers[topic]
        _wait_for(lambda: publisher.get_subscription_count() >= expected)
        return publisher.get_subscription_count()

    def writers(self, topic: str, expected: int) -> int:
        """How many publishers are heard, as soon as there are as many as expected."""
        _wait_for(lambda: self._node.count_publishers(topic) >= expected)
        return self._node.count_publishers(topic)

    def texts(self, topic: str, expected: int, within_s: float = PATIENCE_S) -> list[str]:
        """The texts of the std_msgs/msg/String messages that came, as soon as there are as many as expected."""
        cls = ros_values.message_class("std_msgs/msg/String")
        self._wait(topic, expected, within_s)
        return [deserialize_message(data, cls).data for data in self._received[topic]]

    def forget(self, topic: str) -> None:
        """Destroy what was made for the topic."""
        if topic in self._publishers:
            self._node.destroy_publisher(self._publishers.pop(topic))
        if topic in self._subscriptions:
            self._node.destroy_subscription(self._subscriptions.pop(topic))

    def _publish(self, topic: str, kind: str, message: Any, profile: dict[str, bool]) -> None:
        if topic not in self._publishers:
            cls = ros_values.message_class(kind)
            self._publishers[topic] = self._node.create_publisher(cls, topic, _profile(**profile))
        self._publishers[topic].publish(message)

    def _differences(self, topic: str, expected: Any) -> list[str]:
        self._wait(topic, 1)
        if not self._received[topic]:
            return ["nothing came"]
        data = self._received[topic].pop(0)
        values = ros_values.difference(expected, deserialize_message(data, type(expected)))
        return [found for found in (values, ros_values.cdr_difference(expected, data)) if found]

    def _wait(self, topic: str, expected: int, within_s: float = PATIENCE_S) -> None:
        deadline = time.monotonic() + within_s
        while len(self._received[topic]) < expected and time.monotonic() < deadline:
            rclpy.spin_once(self._node, timeout_sec=0.05)


def _wait_for(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not condition() and time.monotonic() < deadline:
        time.sleep(0.002)


def _profile(*, latched: bool = False, best_effort: bool = False) -> QoSProfile:
    return QoSProfile(
        depth=2000,
        reliability=QoSReliabilityPolicy.BEST_EFFORT if best_effort else QoSReliabilityPolicy.RELIABLE,
        durability=QoSDurabilityPolicy.TRANSIENT_LOCAL if latched else QoSDurabilityPolicy.VOLATILE,
    )


def main() -> None:
    rclpy.init()
    node = Node("server_peer")
    peer = Peer(node)
    sys.stdout.write('"ready"\n')
    sys.stdout.flush()
    for line in sys.stdin:
        command, arguments = json.loads(line)
        sys.stdout.write(json.dumps(getattr(peer, command)(**arguments)) + "\n")
        sys.stdout.flush()
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
