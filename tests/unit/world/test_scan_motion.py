"""How a robot moved between two scans, from scans of a simulated room whose poses are known."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from ros2_mcp.world.scan_motion import motion_between
from ros2_mcp_demo.base import Pose
from ros2_mcp_demo.simulation import Simulation

ANGLES = -math.pi + np.arange(360) * (2 * math.pi / 360)


def seen(robot: Any, pose: Any, mounted: float = 0.0) -> Any:
    """The points of a scan from a pose, by a scanner that is mounted turned by `mounted` and does not know it."""
    robot.base.pose = pose
    ranges = robot.scan(0.01)
    hits = np.isfinite(ranges)
    return np.column_stack(
        [ranges[hits] * np.cos(ANGLES[hits] - mounted), ranges[hits] * np.sin(ANGLES[hits] - mounted)]
    )


@pytest.mark.parametrize(("x", "y", "yaw"), [(0.0, 0.0, 0.0), (1.0, 0.5, 1.0), (3.5, 1.0, 0.3), (2.0, -2.0, -1.0)])
def test_a_drive_and_turns_to_both_sides_are_measured_to_two_centimetres_and_a_degree(
    x: float, y: float, yaw: float
) -> None:
    robot: Any = Simulation(3)
    start: Any = Pose(x, y, yaw)
    driven = motion_between(seen(robot, start), seen(robot, start.moved(0.2, 0.0)), 0.6, math.radians(15))
    assert driven and math.hypot(driven.x_m - 0.2, driven.y_m) < 0.02 and abs(driven.yaw_rad) < math.radians(1)
    for turn in (math.radians(30), math.radians(-32), math.radians(61)):
        found = motion_between(seen(robot, start), seen(robot, start.moved(0.0, turn)), 0.2, math.radians(75))
        assert found and abs(found.yaw_rad - turn) < math.radians(1)


def test_a_scanner_that_is_turned_sees_the_same_turn_and_another_direction() -> None:
    robot: Any = Simulation(3)
    start: Any = Pose(1.0, 0.5, 1.0)
    before = seen(robot, start, math.pi / 2)
    driven = motion_between(before, seen(robot, start.moved(0.2, 0.0), math.pi / 2), 0.6, math.radians(15))
    assert driven and math.degrees(math.atan2(driven.y_m, driven.x_m)) == pytest.approx(-90, abs=6)
    turned = motion_between(before, seen(robot, start.moved(0.0, 0.5), math.pi / 2), 0.2, math.radians(75))
    assert turned and turned.yaw_rad == pytest.approx(0.5, abs=0.02)


def test_a_corridor_a_round_room_and_too_few_points_say_nothing() -> None:
    x = np.linspace(-5, 5, 200)
    corridor = np.concatenate([np.column_stack([x, np.full(200, 1.0)]), np.column_stack([x, np.full(200, -1.0)])])
    assert motion_between(corridor, corridor, 0.6, math.radians(15)) is None
    turns = np.linspace(0, 2 * math.pi, 300, endpoint=False)
    round_room = np.column_stack([2 * np.cos(turns), 2 * np.sin(turns)])
    assert motion_between(round_room, round_room, 0.2, math.radians(75)) is None
    assert motion_between(corridor[:20], corridor[:20], 0.6, 0.3) is None
