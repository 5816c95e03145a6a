"""A network that loses, is narrow and far: with a camera on it, what is driven goes on and nobody waits long."""

from __future__ import annotations

import os
import time
from collections.abc import Callable

import pytest

from support.driver import MOVING, Driver, fresh
from support.network_link import NetworkLink
from support.observer import Observer
from support.processes import peer_command, running
from support.velocities import TWIST, speed

MINUTES = float(os.environ.get("ROS2_MCP_LOSSY_MINUTES", "10"))
HERTZ = 20.0
CAMERA = "/camera/image_raw"
PATIENCE_S = 60.0

pytestmark = [pytest.mark.full, pytest.mark.timeout(60 * MINUTES + 300)]


def test_minutes_of_a_bad_network_stop_nothing_that_nobody_asked_to_stop(
    laptop: Callable[..., Driver], link: NetworkLink, observer: Observer, ros_environment: dict[str, str]
) -> None:
    link.delay_s, link.loss, link.bytes_per_s = 0.05, 0.05, 5e6 / 8
    topic, span_s = fresh("driven"), 60 * MINUTES
    observer.join(by=topic, topic=topic, kind=TWIST)
    with running(ros_environment, *peer_command("camera_peer", "640", "480", "30")):
        server = laptop()
        server.bridge()
        server.knows(topic, 1)
        reading = {"topic_name": CAMERA, "msg_type": "sensor_msgs/msg/Image", "message_limit": 1_000}
        pictures = server.tool("ros2_topic_subscribe", duration=min(span_s, 600), **reading)
        drive = {"topic_name": topic, "message_type": TWIST, "data": speed(TWIST, MOVING)}
        driving = server.tool("ros2_topic_publish", frequency=HERTZ, duration=span_s, **drive)
        ends_at, took = time.monotonic() + span_s, list[float]()
        while time.monotonic() < ends_at - 2.0:
            begun = time.monotonic()
            server.do("ros2_topic_info", topic_name=topic)
            took.append(time.monotonic() - begun)
            time.sleep(0.5)
        sent = server.result(driving, PATIENCE_S)
        seen = server.result(pictures, PATIENCE_S)
        status = server.do("ros2_status")
    took.sort()
    print(f"requests p50 {took[len(took) // 2]:.3f} s, p95 {took[len(took) * 95 // 100]:.3f} s, max {took[-1]:.3f} s;")
    pictures_seen = f"{seen['received']} pictures came there, {seen['dropped']} were left"
    print(f"{sent['sent']} commands sent; {pictures_seen}; the shortest way {status['link_rtt_s']} s", flush=True)
    assert status["bridge_restarts"] == []
    assert not any("link lease" in line for line in status["limitations"])
    assert sent["sent"] >= 0.98 * HERTZ * span_s
