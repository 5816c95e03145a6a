"""What ros2_move_until says."""

from __future__ import annotations

import math
from typing import Any

import pytest

from ros2_mcp.model.poses import Pose
from ros2_mcp.ops.motion.until import MovedUntil, turned_by


@pytest.mark.parametrize(("degrees", "says"), [(0, ""), (3, ""), (180, "180°"), (-90, "-90°")])
def test_a_scanner_that_is_turned_on_the_robot_is_told_of(degrees: float, says: str) -> None:
    half = math.radians(degrees) / 2
    sentence = turned_by(Pose(rotation=(0.0, 0.0, math.sin(half), math.cos(half))), "laser", "base_link")
    assert bool(sentence) == bool(says)
    assert says in sentence


def test_a_condition_that_an_old_message_meets_tells_its_age_in_the_line() -> None:
    moved = until_of(met=True, sent=0, elapsed=0.0, distance_m=None, from_before="1 message, 8.2 s old, from before")
    assert ") by 1 message, 8.2 s old, from before this call; no newer message came." in moved.summary()
    moved = until_of(met=False, elapsed=2.0, from_before="1 message, 8.2 s old, from before")
    assert "); the last message: 1 message, 8.2 s old, from before this call." in moved.summary()


def test_one_line_says_what_ended_it_and_how_far_it_came() -> None:
    moved = until_of(met=True, sent=60, elapsed=3.0, distance_m=0.58, note="A zero command was sent at the end.")
    assert moved.summary() == (
        "/scan: nearest(-20, 20) < 0.6 is met after 3.00 s (nearest(-20, 20) = 0.59). According to /odom the robot "
        "moved 0.58 m. A zero command was sent at the end."
    )


def until_of(**more: Any) -> MovedUntil:
    told: dict[str, Any] = {
        "outcome": "met",
        "topic_name": "/scan",
        "topic_type": "sensor_msgs/msg/LaserScan",
        "condition": "nearest(-20, 20) < 0.6",
        "values": {"nearest(-20, 20)": 0.5900123},
        "messages_checked": 30,
        "not_evaluable": 0,
        "command_topic": "/cmd_vel",
        "velocity": {"linear.x": 0.2},
        "sent": 60,
        "distance_m": 0.58,
        "odometry_topic": "/odom",
    }
    return MovedUntil(**{**told, **more})
