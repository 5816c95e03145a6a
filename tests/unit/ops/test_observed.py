"""What a stop says of the robot itself: observed still, or not observed."""

from __future__ import annotations

import math
from typing import Any

import pytest

from ros2_mcp.guard.document import Feedback
from ros2_mcp.ops.observed import _judged, observe_still, speeds_of
from ros2_mcp.robot import Robot
from support.made_bridge import MadeBridge

ODOM, OTHER = Feedback(topic="/odom"), Feedback(topic="/other")


def odometry(linear: object, angular: object = 0.0) -> dict[str, Any]:
    vector = {"x": 0.0, "y": 0.0, "z": 0.0}
    return {"twist": {"twist": {"linear": {**vector, "x": linear}, "angular": {**vector, "z": angular}}}}


@pytest.mark.promise("stopping", "Each stop says whether odometry tells that the robot stands")
@pytest.mark.parametrize(
    ("spoken", "verdict", "sentence"),
    [
        ({"/odom": (0.0, 0.0)}, "observed still", "Observed still: /odom reports 0.00 m/s and 0.00 rad/s."),
        (
            {"/odom": (0.31, 0.0)},
            "not observed",
            "NOT observed still: /odom reports 0.31 m/s and 0.00 rad/s, after 1.0 s.",
        ),
        (
            {"/odom": (0.0, 0.2)},
            "not observed",
            "NOT observed still: /odom reports 0.00 m/s and 0.20 rad/s, after 1.0 s.",
        ),
        ({}, "not observed", "Not observed: /odom did not report the robot's speed."),
    ],
)
def test_only_what_the_robot_tells_is_observed(
    spoken: dict[str, tuple[float, float]], verdict: str, sentence: str
) -> None:
    found = _judged([ODOM], spoken, 1.0)
    assert (found.verdict, found.sentence) == (verdict, sentence)
    assert found.is_moving == sentence.startswith("NOT")


def test_of_several_all_have_to_say_that_it_stands() -> None:
    still, moving = (0.0, 0.0), (0.5, 0.0)
    assert _judged([ODOM, OTHER], {"/odom": still, "/other": still}, 1.0).verdict == "observed still"
    assert _judged([ODOM, OTHER], {"/odom": still}, 1.0).verdict == "not observed"
    assert _judged([ODOM, OTHER], {"/odom": still, "/other": moving}, 1.0).is_moving


@pytest.mark.parametrize("message", [{}, {"twist": 1}, odometry("nan"), odometry(math.inf), odometry(None)])
def test_what_is_no_speed_is_not_heard(message: dict[str, Any]) -> None:
    assert speeds_of(message, "twist.twist") is None
    assert speeds_of(odometry(0.3, -0.4), "twist.twist") == (0.3, 0.4)


@pytest.mark.parametrize(
    ("topics", "sentence"),
    [
        ([("/odom", ["nav_msgs/msg/Odometry"], 1, 0)], "Not observed: /odom did not report the robot's speed."),
        (
            [("/odom", ["nav_msgs/msg/Odometry"], 0, 1)],
            "Not observed: no odometry reports whether the robot has stopped.",
        ),
        (
            [("/scan", ["sensor_msgs/msg/LaserScan"], 1, 0)],
            "Not observed: no odometry reports whether the robot has stopped.",
        ),
    ],
)
async def test_without_a_policy_the_odometry_that_is_there_is_read(
    robot: Robot, bridge: MadeBridge, topics: list[Any], sentence: str
) -> None:
    bridge.topics, bridge.sent = lambda: topics, ["nav_msgs/msg/Odometry"]
    assert (await observe_still(robot)).sentence == sentence  # this bridge sends no samples
