"""Nodes in processes of their own: `peers.py ROLE ARGUMENT...` prints `ready` when the node is ready."""

from __future__ import annotations

import itertools
import json
import os
import signal
import sys
import threading
import time
from itertools import pairwise
from pathlib import Path

import rclpy
from geometry_msgs.msg import Twist
from rclpy.executors import SingleThreadedExecutor
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from std_msgs.msg import String, UInt64
from std_srvs.srv import SetBool


def topics(node: Node, count: str, first: str = "0") -> None:
    """Create publishers on /bench/t00, /bench/t01 …"""
    numbers = range(int(first), int(first) + int(count))
    node.kept = [node.create_publisher(String, f"/bench/t{number:02}", 10) for number in numbers]


def many(node: Node, nodes: str, topics_each: str) -> None:
    """Create additional nodes, each with `topics_each` publishers: /bench/large/t0 …"""
    others = [rclpy.create_node(f"bench_{number}") for number in range(int(nodes))]
    node.kept = [
        other.create_publisher(String, f"/bench/large/t{number * int(topics_each) + each}", 10)
        for number, other in enumerate(others)
        for each in range(int(topics_each))
    ]


def nodes(node: Node, count: str, first: str = "0") -> None:
    """Create the nodes /bench/n000, /bench/n001 … with rclpy's usual services, all in one participant."""
    numbers = range(int(first), int(first) + int(count))
    node.kept = [Node(f"n{number:03}", namespace="/bench") for number in numbers]
    for one in node.kept:
        node.executor.add_node(one)


def ticks(node: Node, count: str, rate_hz: str) -> None:
    """Publish numbers on /bench/tick0, /bench/tick1 …, each at `rate_hz`."""
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


def reactions(node: Node, count: str, rate_hz: str) -> None:
    """Publish numbers on /bench/tick0 … at `rate_hz`, and measure their answers.

    For each line on stdin, print the times in s from publishing a number to receiving it on /bench/back0 …, for all
    answers since the line before.
    """
    publishers = [node.create_publisher(UInt64, f"/bench/tick{number}", 10) for number in range(int(count))]
    sent_at: list[float] = []
    took_s: list[float] = []

    def publish() -> None:
        due = time.monotonic()
        while True:
            for publisher in publishers:
                sent_at.append(time.monotonic())
                publisher.publish(UInt64(data=len(sent_at) - 1))
            due += 1 / float(rate_hz)
            time.sleep(max(0.0, due - time.monotonic()))

    def hear(message: UInt64) -> None:
        took_s.append(time.monotonic() - sent_at[message.data])

    def serve() -> None:
        for _ in sys.stdin:
            told, took_s[:] = list(took_s), []
            _say(json.dumps(told))

    node.kept = [node.create_subscription(UInt64, f"/bench/back{number}", hear, 10) for number in range(int(count))]
    for work in (publish, serve):
        threading.Thread(target=work, daemon=True).start()


def flood(node: Node, rate_hz: str, count: str) -> None:
    """For each subscriber: publish numbers from 0 on /bench/flood at `rate_hz`, then print how many."""
    publisher = node.create_publisher(UInt64, "/bench/flood", QoSProfile(depth=1000))
    messages = [serialize_message(UInt64(data=number)) for number in range(int(count))]

    def publish() -> None:
        while True:
            while not publisher.get_subscription_count():
                time.sleep(0.01)
            time.sleep(0.3)  # the subscriber matches a moment later than the publisher
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
    """Answer /bench/set at once."""

    def answer(request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        response.success, response.message = request.data, "set"
        return response

    node.kept = node.create_service(SetBool, "/bench/set", answer)


def driven(node: Node, count: str) -> None:
    """Subscribe to /bench/vel0, /bench/vel1 …, and answer lines on stdin.

    `moving N` is answered once N of the topics have velocities that are not zero; `zeros` once all of these topics have
    had a zero, with the monotonic time at which the last of them had its first zero.
    """
    zero_at: dict[int, float] = {}

    def hear(number: int, message: Twist) -> None:
        if message.linear.x:
            zero_at[number] = 0.0
        elif number in zero_at:
            zero_at[number] = zero_at[number] or time.monotonic()

    def subscribe(number: int) -> object:
        return node.create_subscription(Twist, f"/bench/vel{number}", lambda message: hear(number, message), 10)

    def serve() -> None:
        for line in sys.stdin:
            what, _, least = line.strip().partition(" ")
            if what == "moving":
                zero_at.clear()
                while len(zero_at) < int(least):
                    time.sleep(0.005)
                _say("true")
            else:
                while not all(zero_at.values()):
                    time.sleep(0.005)
                _say(json.dumps(max(zero_at.values())))

    node.kept = [subscribe(number) for number in range(int(count))]
    threading.Thread(target=serve, daemon=True).start()


def frames(node: Node, count: str, rate_hz: str) -> None:
    """Publish a chain of moving frames below `map` at `rate_hz`, and a static frame below each."""
    from geometry_msgs.msg import TransformStamped
    from rclpy.qos import DurabilityPolicy
    from tf2_msgs.msg import TFMessage  # installed only by the process that starts this one

    def told(parent: str, child: str) -> TransformStamped:
        one = TransformStamped(child_frame_id=child)
        one.header.frame_id = parent
        one.header.stamp = node.get_clock().now().to_msg()
        one.transform.translation.x = 0.1
        return one

    names = ["map", *(f"moving_{number}" for number in range(int(count)))]
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    static = node.create_publisher(TFMessage, "/tf_static", latched)
    static.publish(TFMessage(transforms=[told(name, f"on_{name}") for name in names]))
    moving = node.create_publisher(TFMessage, "/tf", 100)

    def tick() -> None:
        moving.publish(TFMessage(transforms=[told(*pair) for pair in pairwise(names)]))

    node.kept = static, moving, node.create_timer(1 / float(rate_hz), tick)


def floor(node: Node) -> None:
    """The floor of ROS: for each line `call N`, `read N` or `publish N` on stdin, print the N times in s, as JSON.

    `publish` publishes on /bench/heard, and takes until the acknowledgement.
    """
    client = node.create_client(SetBool, "/bench/set")
    publisher = node.create_publisher(UInt64, "/bench/heard", 1)  # a full history asks for acknowledgement at once
    work = {"call": lambda: _call(client), "read": lambda: _read_one(node), "publish": lambda: _publish_one(publisher)}

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


def _publish_one(publisher: object) -> None:
    publisher.publish(UInt64(data=1))  # type: ignore[attr-defined]
    publisher.wait_for_all_acked()  # type: ignore[attr-defined]


def heard(node: Node) -> None:
    """Subscribe to /bench/heard: Fast DDS acknowledges by default 5 ms after it is asked."""
    node.kept = node.create_subscription(UInt64, "/bench/heard", lambda _: None, 10)


def sights(node: Node) -> None:
    """For each line with a number of seconds on stdin, publish raw 1080p pictures at 30 Hz on /bench/sight0 and clouds
    of 2 MB at 10 Hz on /bench/sight1.

    Both are reliable; publishing begins once both have subscribers. Print the number of messages and the seconds, as
    JSON.
    """
    from sensor_msgs.msg import Image, PointCloud2

    image = Image(height=1080, width=1920, step=5760, encoding="rgb8", data=os.urandom(1920 * 1080 * 3))
    cloud = PointCloud2(height=1, width=125_000, point_step=16, row_step=2_000_000, data=os.urandom(2_000_000))
    kinds = ((Image, image, 30), (PointCloud2, cloud, 10))
    publishers = [node.create_publisher(kind, f"/bench/sight{number}", 10) for number, (kind, *_) in enumerate(kinds)]
    messages = [serialize_message(message) for _, message, _ in kinds]

    def publish(seconds: float) -> str:
        while not all(publisher.get_subscription_count() for publisher in publishers):
            time.sleep(0.01)
        time.sleep(0.3)  # the subscriber matches a moment later than the publisher
        rates = [rate for *_, rate in kinds]
        due = sorted((turn / rate, number) for number, rate in enumerate(rates) for turn in range(int(seconds * rate)))
        began = time.monotonic()
        for at_s, number in due:
            time.sleep(max(0.0, began + at_s - time.monotonic()))
            publishers[number].publish(messages[number])
        return json.dumps([len(due), time.monotonic() - began])

    def serve() -> None:
        for line in sys.stdin:
            _say(publish(float(line)))

    threading.Thread(target=serve, daemon=True).start()


def picture(node: Node, path: str) -> None:
    """Publish a raw 1080p picture on /bench/picture, latched; `path` is a file with its serialized bytes."""
    from rclpy.qos import DurabilityPolicy
    from sensor_msgs.msg import Image

    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    node.kept = node.create_publisher(Image, "/bench/picture", latched)
    node.kept.publish(Path(path).read_bytes())


def recorder(node: Node) -> None:
    """The floor of recording: for a line with a path on stdin, record all topics of `sights` there as MCAP.

    The next line ends the recording and is answered with the number of messages.
    """
    from mcap.writer import CompressionType, Writer
    from sensor_msgs.msg import Image, PointCloud2

    kinds = {
        "/bench/sight0": (Image, "sensor_msgs/msg/Image"),
        "/bench/sight1": (PointCloud2, "sensor_msgs/msg/PointCloud2"),
    }

    def begin(path: str) -> tuple[Writer, list[object], list[int]]:
        writer, written = Writer(path, compression=CompressionType.NONE), [0]
        writer.start("ros2")

        def listen(topic: str, kind: type, name: str) -> object:
            channel = writer.register_channel(topic, "cdr", writer.register_schema(name, "ros2msg", b""))

            def keep(data: bytes, info: dict[str, int]) -> None:
                writer.add_message(channel, info["received_timestamp"], data, info["source_timestamp"])
                written[0] += 1

            return node.create_subscription(kind, topic, keep, QoSProfile(depth=1000), raw=True)

        return writer, [listen(topic, *of) for topic, of in kinds.items()], written

    def end(writer: Writer, subscriptions: list[object], written: list[int]) -> None:
        for subscription in subscriptions:
            node.destroy_subscription(subscription)
        writer.finish()
        _say(written[0])

    def serve() -> None:
        for line in sys.stdin:
            path = line.strip()
            begun = node.executor.create_task(lambda path=path: begin(path))
            sys.stdin.readline()
            node.executor.create_task(lambda begun=begun: end(*begun.result()))

    threading.Thread(target=serve, daemon=True).start()


def drained(node: Node) -> None:
    """For each line with a number of seconds on stdin, print the number of messages on /bench/flood in that time."""

    def receive(seconds: float) -> int:
        numbers = itertools.count()
        made = node.executor.create_task(
            lambda: node.create_subscription(
                UInt64, "/bench/flood", lambda _: next(numbers), QoSProfile(depth=1000), raw=True
            )
        )
        time.sleep(seconds)
        gone = node.executor.create_task(lambda: node.destroy_subscription(made.result()))
        while not gone.done():  # the next flood begins only after that
            time.sleep(0.01)
        return next(numbers)

    def serve() -> None:
        for line in sys.stdin:
            _say(receive(float(line)))

    threading.Thread(target=serve, daemon=True).start()


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
    # The events executor fails with a SystemError while a large message is assembled.
    executor = SingleThreadedExecutor() if role == "recorder" else EventsExecutor()
    executor.add_node(node)
    globals()[role](node, *arguments)
    _say("ready")
    while not told_to_end.is_set():
        executor.spin_once(timeout_sec=0.2)  # in these versions spin() may live-lock
    node.destroy_node()
    rclpy.try_shutdown()
    os._exit(0)  # daemon threads may still use the destroyed node


if __name__ == "__main__":
    main()
