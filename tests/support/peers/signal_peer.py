"""A node that publishes signals of known shape at 50 Hz, and tells on `dump` what it published.

/signal      geometry_msgs/PointStamped: x drifts by 0.4/s, y is a wave, z counts; silent for 0.4 s every 2 s
/signal_late std_msgs/Float64: the same wave 0.2 s later and 1.0 higher
/signal_wave std_msgs/Float64: the wave
/signal_copy geometry_msgs/PointStamped: every message of /signal_steady again
/signal_steady geometry_msgs/PointStamped: as /signal, without silence
/sensor      sensor_msgs/Range: noise, stuck for 50 messages (1 s) in every 150, one NaN in 50
/settings    std_msgs/Float64, latched: 50 messages at the beginning, then 5 Hz
/pulse       std_msgs/Float64: 0, and 7 for one message in 100, at 200 Hz
"""

from __future__ import annotations

import contextlib
import json
import math
import random
import sys
import threading
import time

import rclpy
from geometry_msgs.msg import PointStamped
from rclpy.executors import ExternalShutdownException
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import Range
from std_msgs.msg import Float64


def wave(t: float) -> float:
    return math.sin(2 * t) + 0.5 * math.sin(5.3 * t + 1)


class Signals:
    def __init__(self) -> None:
        self.node = rclpy.create_node("signals")
        deep = QoSProfile(depth=1000)
        kinds = {"signal": PointStamped, "signal_copy": PointStamped, "signal_steady": PointStamped, "sensor": Range}
        names = (*kinds, "signal_late", "signal_wave", "pulse")
        self.publishers = {
            name: self.node.create_publisher(kinds.get(name, Float64), name, deep) for name in names
        }  # fmt: skip
        latched = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.settings = self.node.create_publisher(Float64, "settings", latched)
        for _ in range(50):
            self.settings.publish(Float64())
        self.sent: dict[str, list[tuple[float, float, float]]] = {"signal": [], "signal_steady": []}
        self.began = time.monotonic()
        self.ticks = 0
        self.held = 0.0
        self.node.create_timer(0.005, self.tick)

    def tick(self) -> None:
        self.ticks += 1
        self.publishers["pulse"].publish(Float64(data=0.0 if self.ticks % 100 else 7.0))
        if self.ticks % 4:
            return
        if self.ticks % 40 == 0:
            self.settings.publish(Float64())
        t = time.monotonic() - self.began
        steady = self.point("signal_steady", t)
        self.publishers["signal_copy"].publish(steady)
        if t % 2.0 < 1.6:
            self.point("signal", t)
        self.publishers["signal_wave"].publish(Float64(data=wave(t)))
        self.publishers["signal_late"].publish(Float64(data=wave(t - 0.2) + 1.0))
        if self.ticks % 600 >= 200:
            self.held = random.gauss(5.0, 0.1)
        value = math.nan if self.ticks % 200 == 100 else self.held
        self.publishers["sensor"].publish(Range(range=value))

    def point(self, name: str, t: float) -> PointStamped:
        message = PointStamped()
        message.header.stamp = self.node.get_clock().now().to_msg()
        message.point.x, message.point.y, message.point.z = 0.4 * t, wave(t), float(len(self.sent[name]))
        self.sent[name].append((message.point.x, message.point.y, message.point.z))
        self.publishers[name].publish(message)
        return message


def main() -> None:
    rclpy.init()
    signals = Signals()
    spinning = threading.Thread(target=spin, args=(signals,), daemon=True)
    spinning.start()
    print("ready", flush=True)
    for _ in sys.stdin:
        print(json.dumps(signals.sent), flush=True)
    rclpy.try_shutdown()
    spinning.join(5)


def spin(signals: Signals) -> None:
    with contextlib.suppress(ExternalShutdownException):
        rclpy.spin(signals.node)


main()
