"""The simulated drone without ROS: it flies as its physics let it, and its autopilot takes and refuses orders."""

import math

import numpy as np
import pytest

from ros2_mcp_demo.drone import mission as plans
from ros2_mcp_demo.drone.airframe import Airframe, Wind
from ros2_mcp_demo.drone.autopilot import ACCEPTED, FAILED, ON_GROUND, UNSUPPORTED, Autopilot
from ros2_mcp_demo.drone.simulation import DroneSimulation

DT = 0.02


def pilot(seed=1, wind=(1.5, 0.8), gusts=0.5):
    rng = np.random.default_rng(seed)
    return Autopilot(Airframe(rng, Wind(rng, wind, gusts)))


def fly(autopilot, seconds, until=lambda: False):
    """Let so many seconds pass, or fewer; how many did."""
    for step in range(round(seconds / DT)):
        if until():
            return step * DT
        autopilot.step(DT)
    return seconds


def flying(height=5.0, **of_pilot):
    """An autopilot that hovers at a height in GUIDED."""
    autopilot = pilot(**of_pilot)
    assert autopilot.set_mode("GUIDED")
    assert autopilot.arm(True) == ACCEPTED
    assert autopilot.take_off(height) == ACCEPTED
    fly(autopilot, 30.0, lambda: autopilot.altitude > height - 0.3)
    fly(autopilot, 3.0)
    return autopilot


def texts(autopilot):
    return [text for _, text in autopilot.texts]


def test_it_hovers_where_it_took_off_in_spite_of_the_wind():
    autopilot = flying(wind=(4.0, -3.0), gusts=1.0)
    fly(autopilot, 20.0)
    assert math.dist(autopilot.frame.position, (0.0, 0.0, 5.0)) < 0.6
    assert autopilot.armed


def test_it_has_inertia():
    autopilot = flying()
    autopilot.move((4.0, 0.0, 0.0), 0.0)
    assert fly(autopilot, 10.0, lambda: autopilot.frame.velocity[0] > 3.5) > 1.0
    before = autopilot.frame.position[0]
    autopilot.set_mode("BRAKE")
    fly(autopilot, 6.0)
    assert 0.5 < autopilot.frame.position[0] - before < 5.0
    assert float(np.linalg.norm(autopilot.frame.velocity)) < 0.3


def test_a_velocity_holds_for_three_seconds_without_another_one():
    autopilot = flying()
    assert autopilot.move((2.0, 0.0, 0.0), 0.0)
    fly(autopilot, 10.0)
    assert float(np.linalg.norm(autopilot.frame.velocity)) < 0.4
    assert 3.0 < autopilot.frame.position[0] < 9.0


@pytest.mark.parametrize("mode", ["LAND", "RTL"])
def test_it_comes_down_and_disarms(mode):
    autopilot = flying(height=8.0)
    autopilot.go((12.0, -6.0, 8.0), 0.0)
    fly(autopilot, 10.0)
    assert autopilot.set_mode(mode)
    fly(autopilot, 90.0, lambda: not autopilot.armed)
    assert autopilot.landed_state == ON_GROUND
    home = math.hypot(*autopilot.frame.position[:2])
    assert home < 1.0 if mode == "RTL" else home > 10.0


def test_armed_on_the_ground_it_disarms_by_itself():
    autopilot = pilot()
    assert autopilot.arm(True) == ACCEPTED
    assert 8.0 < fly(autopilot, 30.0, lambda: not autopilot.armed) < 12.0


def test_what_is_disarmed_in_the_air_by_force_falls():
    autopilot = flying(height=10.0)
    assert autopilot.arm(False) == FAILED
    assert "it flies" in texts(autopilot)[-1]
    assert autopilot.command(plans.ARM_DISARM, [0.0, 21196.0, *[0.0] * 5]) == ACCEPTED
    assert fly(autopilot, 10.0, lambda: autopilot.frame.is_on_ground) < 2.5
    assert autopilot.frame.fell_at > 8.0


@pytest.mark.parametrize(
    ("order", "code", "why"),
    [
        (lambda it: it.take_off(5.0), FAILED, "the mode is STABILIZE, not GUIDED"),
        (lambda it: it.set_mode("GUIDED") and it.take_off(5.0), FAILED, "the motors are not armed"),
        (
            lambda it: (it.set_mode("GUIDED") and it.arm(True)) or it.take_off(500.0),
            FAILED,
            "above the ceiling of 100 m",
        ),
        (lambda it: (it.set_mode("GUIDED") and it.arm(True)) or it.take_off(-1.0), FAILED, "not one to fly at"),
        (lambda it: it.command(plans.START_MISSION, [0.0] * 7), FAILED, "the motors are not armed"),
        (lambda it: it.set_mode("AUTO") or FAILED, FAILED, "there is no mission"),
        (lambda it: it.set_mode("RTL") or FAILED, FAILED, "the motors are not armed"),
        (lambda it: it.set_mode("BRAKE") and it.arm(True), FAILED, "BRAKE mode not armable"),
        (lambda it: it.command(9999, [0.0] * 7), UNSUPPORTED, "Command 9999 is not supported"),
    ],
)
def test_a_wrong_order_is_refused_with_a_reason_and_moves_nothing(order, code, why):
    autopilot = pilot()
    assert order(autopilot) == code
    assert why in texts(autopilot)[-1]
    fly(autopilot, 2.0)
    assert autopilot.frame.is_on_ground


def test_a_mission_above_the_ceiling_or_with_unknown_items_is_not_taken():
    autopilot, none = pilot(), (0.0,) * 4
    home = plans.item_of(plans.WAYPOINT, 3, none, *plans.degrees(0, 0), 0.0)
    high = plans.item_of(plans.TAKEOFF, 3, none, *plans.degrees(0, 0), 130.0)
    assert "item 1: 130 m is above the ceiling" in autopilot.push([home, high])
    assert autopilot.items == []
    for command, frame, place in ((5000, 3, (47.0, 8.0)), (16, 1, (47.0, 8.0)), (16, 3, (math.nan, 8.0))):
        with pytest.raises(ValueError, match=r"not supported|not finite"):
            plans.item_of(command, frame, none, *place, 10.0)


def test_by_hand_it_takes_off_without_arming_and_disarms_where_it_is_flown_down():
    autopilot = pilot()
    autopilot.fly_by_hand((0.0, 0.0, -1.0), 0.0)
    assert not autopilot.armed
    for _ in range(40):
        autopilot.fly_by_hand((0.0, 0.0, 0.5), 0.0)
        fly(autopilot, 0.05)
    assert 0.6 < autopilot.altitude < 1.3
    fly(autopilot, 5.0)
    assert 0.5 < autopilot.altitude < 1.8  # it hovers without commands
    for _ in range(200):
        autopilot.fly_by_hand((0.0, 0.0, -0.5), 0.0)
        fly(autopilot, 0.05)
    assert (autopilot.armed, autopilot.landed_state) == (False, ON_GROUND)


def test_a_low_battery_brings_it_home():
    autopilot = flying()
    autopilot.frame.battery.charge = 0.1
    fly(autopilot, 1.0)
    assert autopilot.mode == "RTL"
    assert any("Battery failsafe" in text for text in texts(autopilot))


def test_sped_up_the_same_happens_in_less_time():
    slow, fast = DroneSimulation(3), DroneSimulation(3)
    fast.speedup = 5
    for _ in range(50):
        slow.step(DT)
    for _ in range(10):
        fast.step(DT)
    assert slow.now == fast.now == pytest.approx(1.0)
