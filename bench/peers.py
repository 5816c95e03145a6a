"""Nodes in processes of their own: `peers.py ROLE ARGUMENT...` prints a line when it is ready."""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
import time

import rclpy
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from std_msgs.msg import String, UInt64
from std_srvs.srv import SetBool


def topics(node: Node, count: str, first: str = "0") -> None:
    """Publishers on /bench/t00, /bench/t01 …"""
    numbers = range(int(first), int(first) + int(count))
    node.kept = [node.create_publisher(String, f"/bench/t{number:02}", 10) for number in numbers]


def ticks(node: Node, count: str, rate_hz: str) -> None:
    """Numbers on /bench/tick0, /bench/tick1 …, all at that rate."""
    publishers = [node.create_publisher(UInt64, f"/bench/tick{number}", 10) for number in range(int(count))]
    period_s, sent = 1 / float(rate_hz), 0

    def publish() -> None:
        nonlocal sent
        due = time.monotonic()
        while True:
            for publisher in publishers:
                publisher.publish(UInt64(data=sent))
            sent += 1
            due += period_s
            time.sleep(max(0.0, due - time.monotonic()))

    threading.Thread(target=publish, daemon=True).start()


def flood(node: Node, rate_hz: str, count: str) -> None:
    """Whenever a subscriber comes: numbers from 0 on /bench/flood at that rate, then a line with how many."""
    publisher = node.create_publisher(UInt64, "/bench/flood", QoSProfile(depth=1000))
    messages = [serialize_message(UInt64(data=number)) for number in range(int(count))]

    def publish() -> None:
        while True:
            while not publisher.get_subscription_count():
                time.sleep(0.01)
            time.sleep(0.3)  # the other side learns of the match a moment later
            _publish_all(publisher, messages, float(rate_hz))
            _say(len(messages))
            while publisher.get_subscription_count():
                time.sleep(0.01)

    threading.Thread(target=publish, daemon=True).start()


def _publish_all(publisher: object, messages: list[bytes], rate_hz: float) -> None:
    started, sent = time.monotonic(), 0
    while sent < len(messages):
        due = min(len(messages), int((time.monotonic() - started) * rate_hz))
        for message in messages[sent:due]:
            publisher.publish(message)  # type: ignore[attr-defined]
        sent = due
        time.sleep(0.001)


def service(node: Node) -> None:
    """Answers /bench/set at once."""

    def answer(request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        response.success, response.message = request.data, "set"
        return response

    node.kept = node.create_service(SetBool, "/bench/set", answer)


def floor(node: Node) -> None:
    """The floor of ROS: for each line `call N` or `read N` on stdin, the seconds that each took, in JSON."""
    client = node.create_client(SetBool, "/bench/set")
    work = {"call": lambda: _call(client), "read": lambda: _read_one(node)}

    def serve() -> None:
        for line in sys.stdin:
            what, count = line.split()
            _say(json.dumps([_timed(work[what]) for _ in range(int(count))]))

    threading.Thread(target=serve, daemon=True).start()


def _call(client: object) -> None:
    answered = threading.Event()
    client.wait_for_service()  # type: ignore[attr-defined]
    client.call_async(SetBool.Request(data=True)).add_done_callback(lambda _: answered.set())  # type: ignore[attr-defined]
    answered.wait()


def _read_one(node: Node) -> None:
    arrived = threading.Event()
    made = node.executor.create_task(
        lambda: node.create_subscription(UInt64, "/bench/tick0", lambda _: arrived.set(), 10)
    )
    arrived.wait()
    node.executor.create_task(lambda: node.destroy_subscription(made.result()))


def _timed(work: object) -> float:
    started = time.perf_counter()
    work()  # type: ignore[operator]
    return time.perf_counter() - started


def _say(text: object) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def main() -> None:
    role, *arguments = sys.argv[1:]
    rclpy.init()
    told_to_end = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: told_to_end.set())
    node = Node(f"bench_{role}")
    executor = EventsExecutor()
    executor.add_node(node)
    globals()[role](node, *arguments)
    _say("ready")
    while not told_to_end.is_set():
        executor.spin_once(timeout_sec=0.2)  # in these versions spin() may live-lock
    node.destroy_node()
    rclpy.try_shutdown()
    os._exit(0)  # daemon threads may still use what has just been destroyed


if __name__ == "__main__":
    main()
