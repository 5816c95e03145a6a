"""A bridge that ends leaves ROS, whatever was under way: nobody lists it any more, and its shared memory is gone."""

from __future__ import annotations

import json

from ros2_mcp_common.policy.rules import Rules, RuleSet
from support import own_processes, shared_memory
from support.bridge_client import PATIENCE_S, Client
from support.observer import Observer
from support.velocities import TWIST_STAMPED


def test_a_bridge_whose_watchdog_hears_the_robot_leaves_nothing(start, observer: Observer, tmp_path) -> None:
    bridge = Client(start("ros2_mcp_bridge", "--state", str(tmp_path)))
    rules = Rules("digest", (RuleSet("test", allows_all=True),)).as_json()
    world = {"frame_id": "map", "polygon": [[-1e6, -1e6], [1e6, -1e6], [0, 1e6]], "margin_m": 0.0}
    place = {"topic": "/place", "type": TWIST_STAMPED, "path": "twist", "frame_id": "map", "zone": world}
    pose = {**place, "brake_mps2": 1.0, "max_age_s": 60.0}
    bridge.ok("policy", json.dumps({**rules, "watch": {"pose": pose}}).encode())
    observer.talk(topic="/place", kind=TWIST_STAMPED, hz=10.0, value=0.1)
    bridge.ok("wait_endpoints", topic="/place", publishers=1, subscribers=1, timeout_s=PATIENCE_S)
    bridge.process.terminate()
    assert bridge.process.wait(PATIENCE_S) == 0
    left = [segment.process for segment in shared_memory.dead_segments()]
    assert bridge.process.pid & own_processes.HALF not in left
