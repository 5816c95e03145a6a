"""Independent rclpy nodes for the tests of the bridge: `bridge_peer.py ROLE ...` prints one line when it is ready.

If the environment names a node in KNOWS, it is ready only when it knows that node.
"""

from __future__ import annotations

import os
import sys
import time

import rclpy
from geometry_msgs.msg import Twist
from rclpy.action import ActionServer
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from rclpy.serialization import serialize_message
from std_msgs.msg import String
from std_srvs.srv import SetBool
from test_msgs.action import Fibonacci

from support.leaving import leave_on_sigterm

CATCH_UP_S = 0.02
"""A flood that was held up for longer than this goes on later: it does not become a burst."""


def say(text: object) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def profile(reliability: str) -> QoSProfile:
    return QoSProfile(depth=1000, reliability=QoSReliabilityPolicy[reliability])


def topics(node: Node, prefix: str, count: str) -> list[object]:
    """Have `count` publishers on `/prefix/t0` and so on."""
    return [node.create_publisher(String, f"/{prefix}/t{number}", 10) for number in range(int(count))]


def listen(node: Node, topic: str, reliability: str) -> object:
    """Print the text of every message."""
    return node.create_subscription(String, topic, lambda message: say(message.data), profile(reliability))


def drive(node: Node, topic: str) -> object:
    """Print how fast every velocity command wants to go."""
    return node.create_subscription(Twist, topic, lambda message: say(message.linear.x), profile("RELIABLE"))


def flood(node: Node, topic: str, reliability: str, rate_hz: str, count: str) -> object:
    """Wait for a subscriber, publish `count` messages at the rate, print how many; then one more for each line."""
    publisher = node.create_publisher(String, topic, profile(reliability))
    say("ready")
    while publisher.get_subscription_count() < 1:
        time.sleep(0.005)
    message, started, sent = serialize_message(String(data="x" * 40)), time.monotonic(), 0
    while sent < int(count):
        time.sleep(0.001)
        started = max(started, time.monotonic() - sent / float(rate_hz) - CATCH_UP_S)
        due = min(int(count), int((time.monotonic() - started) * float(rate_hz)))
        for _ in range(sent, due):
            publisher.publish(message)
        sent = due
    say(sent)
    while sys.stdin.readline():
        publisher.publish(message)
        sent += 1
        say(sent)
    return publisher


def serve(node: Node, service: str, delay_s: str) -> object:
    """Print what is asked of a SetBool, and answer with it after a delay."""

    def answer(request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        response.success, response.message = request.data, f"asked {request.data}"
        say(response.message)
        time.sleep(float(delay_s))
        return response

    return node.create_service(SetBool, service, answer)


def act(node: Node, action: str) -> object:
    """Serve the action Fibonacci; every goal ends at once."""

    def execute(goal: object) -> Fibonacci.Result:
        goal.publish_feedback(Fibonacci.Feedback(sequence=[0, 1]))
        goal.succeed()
        return Fibonacci.Result(sequence=[0, 1, 1])

    return ActionServer(node, Fibonacci, action, execute)


def know(node: Node, other: str) -> None:
    """Wait until the other is known by name: it says that itself, to those whom it knows."""
    while other not in node.get_node_names():
        time.sleep(0.01)


def main() -> None:
    role, *arguments = sys.argv[1:]
    rclpy.init()
    leave_on_sigterm()
    node, entities = Node(f"{role}_peer"), None
    try:
        if other := os.environ.get("KNOWS"):
            know(node, other)
        entities = globals()[role](node, *arguments)
        if role != "flood":
            say("ready")
        while rclpy.ok():
            rclpy.spin_once(node, timeout_sec=0.1)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        del entities
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
