"""Nudges learn from their own way how long they have to be, at whatever speed a robot begins to move."""

from __future__ import annotations

import math

import pytest

from ros2_mcp_bridge.motion.nudges import MOST_S, Nudges

NEAR = math.radians(1.0)
FASTEST = 1.0


def carried(speed: float, length_s: float, least: float, acceleration: float) -> float:
    """How far a robot comes that does not move below `least` rad/s and speeds up by so much."""
    if abs(speed) < least:
        return 0.0
    reached = min(abs(speed), acceleration * length_s)
    return math.copysign(reached * length_s, speed)


@pytest.mark.parametrize("left_deg", [-15.0, -2.0, 1.5, 6.0])
@pytest.mark.parametrize("least", [0.0, 0.3, 0.6])
@pytest.mark.parametrize("acceleration", [1.0, 5.0, 100.0])
def test_a_few_carry_a_robot_over_what_is_left(left_deg: float, least: float, acceleration: float) -> None:
    nudges, left = Nudges(0.002), math.radians(left_deg)
    for _ in range(8):
        if abs(left) < NEAR:
            break
        nudge = nudges.next(left, 0.2, FASTEST)
        moved = carried(nudge.speed, nudge.length_s, least, acceleration)
        assert abs(nudge.speed) <= FASTEST
        assert nudge.length_s <= MOST_S
        nudges.learn(nudge.length_s, moved * math.copysign(1.0, nudge.speed))
        left -= moved
    assert abs(left) < NEAR
