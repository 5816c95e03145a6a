"""A robot to which things happen on command: one JSON line in, one out, with the moment at which it happened.

Moments are of the monotonic clock, which all processes of this machine share.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.action import ActionServer
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from std_msgs.msg import String, UInt8MultiArray
from test_msgs.action import Fibonacci


class Peer:
    """Its public methods are the commands."""

    def __init__(self) -> None:
        self._node = Node("events_peer")
        self._node.declare_parameter("speed", 1.0)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._guests: dict[str, Node] = {}
        self._ended = 0.0
        self._said = self._node.create_publisher(String, "/events/said", 10)
        self._diagnostics = self._node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._action = ActionServer(self._node, Fibonacci, "/events/count", self._count)
        self._fast: Any = None
        self._flooded = 0
        threading.Thread(target=self._executor.spin, daemon=True).start()

    def say(self, text: str) -> float:
        """Publish a text."""
        return _at(lambda: self._said.publish(String(data=text)))

    def come_or_go(self, name: str) -> float:
        """A node comes, or goes where it is there."""
        guest = self._guests.pop(name, None)
        return _at(guest.destroy_node if guest else lambda: self._guests.update({name: Node(name)}))

    def log(self, level: str, text: str) -> float:
        """Write a line to the log."""
        logger = self._node.get_logger()  # one place of the program may log at one level only
        lines = {
            "info": lambda: logger.info(text),
            "warning": lambda: logger.warning(text),
            "error": lambda: logger.error(text),
        }
        return _at(lines[level])

    def diagnose(self, level: int) -> float:
        """Say how a component is."""
        status = DiagnosticStatus(name="pump", level=bytes([level]), message=f"level {level}")
        return _at(lambda: self._diagnostics.publish(DiagnosticArray(status=[status])))

    def tune(self, value: float) -> float:
        """Set a parameter."""
        return _at(lambda: self._node.set_parameters([Parameter("speed", value=value)]))

    def ended(self) -> float:
        """When the last goal ended."""
        return self._ended

    def flood(self, rate_hz: float, size: int) -> float:
        """Publish large messages at a rate on /events/fast, best effort; 0 Hz ends it."""
        done = threading.Event()
        task = self._executor.create_task(self._set_flood, rate_hz, size)  # rclpy's executor dies of other threads'
        task.add_done_callback(lambda _: done.set())
        assert done.wait(20), "the executor hangs"
        task.result()
        return time.monotonic()

    def flooded(self) -> tuple[int, float]:
        """How many of these messages it has published until now, and this moment."""
        return self._flooded, time.monotonic()

    def _set_flood(self, rate_hz: float, size: int) -> None:
        if self._fast:
            self._node.destroy_timer(self._fast[1])
            self._node.destroy_publisher(self._fast[0])
            self._fast = None
        if rate_hz:
            qos = QoSProfile(depth=5, reliability=QoSReliabilityPolicy.BEST_EFFORT)
            publisher = self._node.create_publisher(UInt8MultiArray, "/events/fast", qos)
            message = UInt8MultiArray(data=bytes(size))

            def publish() -> None:
                publisher.publish(message)
                self._flooded += 1

            self._fast = publisher, self._node.create_timer(1 / rate_hz, publish)

    def subscribers(self, topic: str) -> int:
        """How many subscriptions a topic has."""
        return self._node.count_subscribers(topic)

    def _count(self, goal: Any) -> Fibonacci.Result:
        goal.succeed()
        self._ended = time.monotonic()
        return Fibonacci.Result(sequence=[0, 1])


def _at(event: Callable[[], object]) -> float:
    moment = time.monotonic()
    event()
    return moment


def main() -> None:
    rclpy.init()
    peer = Peer()
    sys.stdout.write('"ready"\n')
    sys.stdout.flush()
    for line in sys.stdin:
        command, arguments = json.loads(line)
        sys.stdout.write(json.dumps(getattr(peer, command)(**arguments)) + "\n")
        sys.stdout.flush()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
