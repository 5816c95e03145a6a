"""Nodes that tell transforms, as the lines of its input say: each is one edge as JSON, or its end.

`{"node": "a", "parent": "odom", "child": "base_link", "hz": 20, "x": 1.0, "speed": 0.5, "late_s": 0.0}` is told from
now on by the node /a ; with `"static": true` once, latched (unless `"latched": false`); `"hz": 0` ends it, and
`"leaves": true` the node. Its stamps are `late_s` behind. With `"namespace": "/robot1"` it is told on /robot1/tf. With
`"stamp_s": 5.0` the stamp is that, and /clock says it, too, ten times a second.
"""

from __future__ import annotations

import contextlib
import json
import sys
import threading
import time
from typing import Any

import rclpy
from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock
from tf2_msgs.msg import TFMessage

LATCHED = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Teller:
    """One node with its publishers, and the edges that it tells."""

    def __init__(self, name: str, executor: SingleThreadedExecutor) -> None:
        self.node = rclpy.create_node(name)
        executor.add_node(self.node)
        self.publishers: dict[str, Any] = {}
        self.timers: dict[str, Any] = {}
        self.static: dict[str, Any] = {}
        self.clock: Any = None

    def tell(self, edge: dict[str, Any]) -> None:
        child = edge["child"]
        if timer := self.timers.pop(child, None):
            timer.destroy()
        if edge.get("static"):
            self.static[child] = self.transform(edge)
            qos = LATCHED if edge.get("latched", True) else QoSProfile(depth=100)
            self.publisher(f"{edge.get('namespace', '')}/tf_static", qos).publish(
                TFMessage(transforms=[*self.static.values()])
            )
        elif edge["hz"]:
            publisher = self.publisher(f"{edge.get('namespace', '')}/tf", QoSProfile(depth=100))
            began = time.time()

            def tick() -> None:
                publisher.publish(TFMessage(transforms=[self.transform(edge, time.time() - began)]))

            self.timers[child] = self.node.create_timer(1 / edge["hz"], tick)
            if "stamp_s" in edge and not self.clock:
                self.clock = self.node.create_publisher(Clock, "/clock", QoSProfile(depth=1))
                time_ns = round(edge["stamp_s"] * 1e9)
                stands = Clock(clock=Time(sec=time_ns // 10**9, nanosec=time_ns % 10**9))
                self.node.create_timer(0.1, lambda: self.clock.publish(stands))

    def publisher(self, topic: str, qos: QoSProfile) -> Any:
        if topic not in self.publishers:
            self.publishers[topic] = self.node.create_publisher(TFMessage, topic, qos)
        return self.publishers[topic]

    def transform(self, edge: dict[str, Any], since_s: float = 0.0) -> TransformStamped:
        told = TransformStamped(child_frame_id=edge["child"])
        told.header.frame_id = edge["parent"]
        stamp_ns = round(edge["stamp_s"] * 1e9) if "stamp_s" in edge else time.time_ns()
        stamp_ns -= round(edge.get("late_s", 0.0) * 1e9)
        told.header.stamp.sec, told.header.stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
        told.transform.translation.x = float(edge.get("x", 0.0) + edge.get("speed", 0.0) * since_s)
        told.transform.rotation.w = float(edge.get("w", 1.0))
        return told


def main() -> None:
    rclpy.init()
    executor = SingleThreadedExecutor()
    tellers: dict[str, Teller] = {}
    waiting: list[dict[str, Any]] = []
    control = rclpy.create_node("tf_peer")
    executor.add_node(control)

    def obey() -> None:
        while waiting:
            edge = waiting.pop(0)
            if edge.get("leaves"):
                executor.remove_node(tellers[edge["node"]].node)
                tellers.pop(edge["node"]).node.destroy_node()
                continue
            if edge["node"] not in tellers:
                tellers[edge["node"]] = Teller(edge["node"], executor)
            tellers[edge["node"]].tell(edge)

    def listen() -> None:
        for line in sys.stdin:
            waiting.append(json.loads(line))
        rclpy.try_shutdown()

    control.create_timer(0.02, obey)
    threading.Thread(target=listen, daemon=True).start()
    print("ready", flush=True)
    with contextlib.suppress(ExternalShutdownException, KeyboardInterrupt):
        executor.spin()
    rclpy.try_shutdown()


main()
