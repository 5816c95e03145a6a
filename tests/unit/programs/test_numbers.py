"""What programs compute on messages."""

import math
import random

import numpy as np
import pytest

from ros2_mcp.programs.numbers import NUMBERS

SCAN = [1.5, math.inf, "inf", "nan", None, 0.5, math.nan, 2.5]


def number(name, *given):
    return NUMBERS[name](*given)


def test_what_is_no_finite_number_is_left_out():
    assert number("finite", SCAN) == [1.5, 0.5, 2.5]
    assert (number("min", SCAN), number("max", SCAN), number("mean", SCAN)) == (0.5, 2.5, 1.5)
    assert number("percentile", SCAN, 50) == 1.5


@pytest.mark.parametrize("name", ["min", "max", "mean", "std", "mean_angle"])
def test_nothing_has_no_mean(name):
    with pytest.raises(ValueError, match="no finite number"):
        number(name, ["nan", None])


def test_a_text_is_no_list_of_numbers():
    with pytest.raises(TypeError, match="not str"):
        number("mean", "12")


def test_they_agree_with_numpy():
    chance = random.Random(15)
    for _ in range(200):
        values = [chance.uniform(-10, 10) for _ in range(chance.randint(2, 50))]
        times = [chance.uniform(0, 60) + place for place in range(len(values))]
        percent = chance.uniform(0, 100)
        assert number("percentile", values, percent) == pytest.approx(np.percentile(values, percent))
        assert number("mean", values) == pytest.approx(np.mean(values))
        assert number("std", values) == pytest.approx(np.std(values))
        assert number("slope", values, times) == pytest.approx(np.polyfit(times, values, 1)[0])


def test_a_slope_keeps_its_digits_at_unix_times():
    times = [1.7e9 + 0.01 * step for step in range(100)]
    assert number("slope", [0.2 * step * 0.01 for step in range(100)], times) == pytest.approx(0.2, rel=1e-4)


def test_a_slope_needs_two_times():
    with pytest.raises(ValueError, match="two times"):
        number("slope", [1, 2], [3, 3])
    with pytest.raises(ValueError, match="2 values and 1 times"):
        number("slope", [1, 2], [3])


@pytest.mark.parametrize(
    ("from_deg", "to_deg", "turn_deg"), [(170, -170, 20), (-170, 170, -20), (0, 180, 180), (10, 730, 0), (90, 45, -45)]
)
def test_a_turn_takes_the_short_way(from_deg, to_deg, turn_deg):
    turn = number("angle_difference", math.radians(from_deg), math.radians(to_deg))
    assert math.degrees(turn) == pytest.approx(turn_deg, abs=1e-9)


def test_a_direction_is_said_once():
    assert number("normalize_angle", -math.pi) == math.pi
    assert number("normalize_angle", 3 * math.pi) == pytest.approx(math.pi)


def test_a_mean_direction_does_not_jump_where_angles_do():
    assert abs(number("mean_angle", [math.radians(179), math.radians(-179)])) == pytest.approx(math.pi)
    with pytest.raises(ValueError, match="cancel"):
        number("mean_angle", [0.0, math.pi])


def half(angle):
    return {"x": 0.0, "y": 0.0, "z": math.sin(angle / 2), "w": math.cos(angle / 2)}


@pytest.mark.parametrize(
    "wrapped",
    [
        lambda q: q,
        lambda q: [q["x"], q["y"], q["z"], q["w"]],
        lambda q: {"position": {"x": 1.0, "y": 2.0, "z": 0.0}, "orientation": q},
        lambda q: {"pose": {"pose": {"position": {"x": 1.0, "y": 2.0, "z": 0.0}, "orientation": q}}},
        lambda q: {"transform": {"translation": {"x": 1.0, "y": 2.0, "z": 0.0}, "rotation": q}},
    ],
)
def test_a_heading_is_found_in_what_has_one(wrapped):
    for angle in (-3.0, -0.5, 0.0, 1.0, 3.1):
        assert number("yaw", wrapped(half(angle))) == pytest.approx(angle)


def test_a_quaternion_of_any_length_has_its_heading_and_one_that_nobody_filled_in_has_none():
    assert number("yaw", {name: 7 * part for name, part in half(1.0).items()}) == pytest.approx(1.0)
    with pytest.raises(ValueError, match="never filled in"):
        number("yaw", {"x": 0.0, "y": 0.0, "z": 0.0, "w": 0.0})
    with pytest.raises(ValueError, match="there is no"):
        number("yaw", {"x": 0.0})


def test_a_distance_is_of_points_poses_and_lists():
    assert number("distance", {"x": 0, "y": 0}, {"x": 3, "y": 4}) == 5
    assert number("distance", [0, 0], {"pose": {"position": {"x": 3, "y": 4, "z": 0}}}) == 5
    with pytest.raises(ValueError, match="no y"):
        number("distance", {"x": 0}, [1, 2])
