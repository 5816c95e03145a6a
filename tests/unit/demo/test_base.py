import math

import numpy as np
import pytest

from ros2_mcp_demo.base import RADIUS, Base, Pose
from ros2_mcp_demo.world import World

DT = 0.02


def base_at(x=0.0, y=0.0, yaw=0.0):
    return Base(World([]), np.random.default_rng(1), Pose(x, y, yaw))


def drive(base, linear, angular, seconds):
    for _ in range(round(seconds / DT)):
        base.step(linear, angular, DT)
    return base


def test_the_base_gains_speed_no_faster_than_its_limit_and_then_keeps_it():
    base = base_at()
    assert drive(base, 0.4, 0.0, 0.2).linear == pytest.approx(0.2)
    assert drive(base, 0.4, 0.0, 0.4).linear == pytest.approx(0.4)


def test_it_drives_the_way_that_speed_and_time_say():
    base = drive(base_at(-1.5), 0.4, 0.0, 5.0)
    assert base.pose.x + 1.5 == pytest.approx(0.4 * 5.0 - 0.08, rel=0.02)


def test_it_turns_on_the_spot():
    base = drive(base_at(), 0.0, 1.0, 1.0)
    assert base.pose.yaw == pytest.approx(1.0 - 0.125, rel=0.05)
    assert math.hypot(base.pose.x, base.pose.y) < 0.02


def test_odometry_drifts_a_little_from_the_truth():
    base = drive(base_at(), 0.3, 1.0, 30.0)
    drift = math.dist((base.pose.x, base.pose.y), (base.odometry.x, base.odometry.y))
    assert 0.001 < drift < 0.3


def test_a_wall_stops_it_and_it_says_that_it_is_blocked():
    base = drive(base_at(1.0), 0.5, 0.0, 5.0)
    assert base.pose.x == pytest.approx(2.45 - RADIUS, abs=0.02)
    assert (base.linear, base.blocked) == (0.0, True)


def test_it_can_back_away_from_a_wall():
    base = drive(base_at(1.0), 0.5, 0.0, 5.0)
    before = base.pose.x
    drive(base, -0.3, 0.0, 1.0)
    assert base.pose.x < before - 0.15
    assert not base.blocked


def test_it_can_leave_a_place_that_is_too_close_to_a_wall():
    base = drive(base_at(2.3), -0.3, 0.0, 1.0)
    assert base.pose.x < 2.1


def test_it_never_gets_into_a_wall_however_it_drives():
    base, rng = base_at(), np.random.default_rng(3)
    for _ in range(60):
        drive(base, rng.uniform(-1, 1), rng.uniform(-2, 2), 0.5)
        assert World([]).clearance(base.pose.x, base.pose.y) > RADIUS - 0.02
