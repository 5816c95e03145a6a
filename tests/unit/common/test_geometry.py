"""A quaternion of any length has one yaw, and server and bridge take the same."""

from __future__ import annotations

import math
import random
from types import SimpleNamespace
from typing import Any

import pytest

from ros2_mcp.model.poses import Pose, from_roll_pitch_yaw
from ros2_mcp.programs import numbers
from ros2_mcp_bridge.motion import drive
from ros2_mcp_common.geometry import yaw_rad
from ros2_mcp_common.language import conditions

LENGTHS = [1.0, 0.5, 0.999, 1.01, 3.0, 1e-150, 1e150]


def odometry(x: float, y: float, z: float, w: float) -> Any:
    turn, at = SimpleNamespace(x=x, y=y, z=z, w=w), SimpleNamespace(x=0.0, y=0.0, z=0.0)
    return SimpleNamespace(pose=SimpleNamespace(pose=SimpleNamespace(position=at, orientation=turn)))


@pytest.mark.parametrize("length", LENGTHS)
def test_the_length_of_a_quaternion_does_not_matter_anywhere(length: float) -> None:
    chance = random.Random(length)
    for _ in range(200):
        yaw, roll, pitch = chance.uniform(-3.1, 3.1), chance.uniform(-1, 1), chance.uniform(-1, 1)
        x, y, z, w = (part * length for part in from_roll_pitch_yaw(roll, pitch, yaw))
        told = odometry(x, y, z, w)
        orientation = told.pose.pose.orientation
        found = [
            yaw_rad(x, y, z, w),
            Pose((0.0, 0.0, 0.0), (x, y, z, w)).yaw_rad,
            Pose((0.0, 0.0, 0.0), (x, y, z, w)).roll_pitch_yaw_rad[2],
            drive._pose_of(told).yaw,
            conditions._yaw(orientation),
        ]
        found += [numbers.yaw(vars(orientation))] if length >= 0.5 else []
        assert found == pytest.approx([yaw] * len(found), abs=1e-9)


def test_a_quaternion_that_nobody_has_filled_in_heads_along_x_and_one_of_no_number_nowhere() -> None:
    assert yaw_rad(0.0, 0.0, 0.0, 0.0) == 0.0
    assert math.isnan(yaw_rad(0.0, math.nan, 0.0, 1.0)) and math.isnan(yaw_rad(math.inf, 0.0, 0.0, -math.inf))
