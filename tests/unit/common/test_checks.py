"""Values are judged alike as JSON objects and as messages, and what cannot be judged fails."""

from __future__ import annotations

import math
import random
import struct
from typing import Any

import pytest

from ros2_mcp_common.policy.checks import Checks, Pace, Zone, clamp, problem

HALL = Zone("map", ((0, 0), (10, 0), (10, 8), (0, 8)), 0.5)
ZONES = {"hall": HALL}


class Message:
    """As rclpy's messages are: fields with types; what is `float` is kept as float32."""

    def __init__(self, fields: dict[str, tuple[str, Any]]) -> None:
        self._types = {name: kind for name, (kind, _) in fields.items()}
        for name, (kind, value) in fields.items():
            setattr(self, name, struct.unpack("<f", struct.pack("<f", value))[0] if kind == "float" else value)

    def get_fields_and_field_types(self) -> dict[str, str]:
        return self._types


def vector(x: float, y: float, z: float) -> Message:
    return Message({axis: ("double", value) for axis, value in (("x", x), ("y", y), ("z", z))})


def as_message(value: dict[str, Any]) -> Message:
    return Message({part: ("geometry_msgs/Vector3", vector(**each)) for part, each in value.items()})


def as_object(message: Message) -> dict[str, Any]:
    return {
        name: as_object(value) if isinstance(value := getattr(message, name), Message) else value
        for name in message.get_fields_and_field_types()
    }


def twist(x: float = 0.0, y: float = 0.0, turn: float = 0.0) -> dict[str, Any]:
    return {"linear": {"x": x, "y": y, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": turn}}


BASE = Checks(norm={"linear": 0.2, "angular": 0.5}, zero=("linear.z", "angular.x", "angular.y"))


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, "nan", "inf", "0.1", None, True, {}, 1e308])
def test_what_is_no_number_within_the_limit_fails(value: Any) -> None:
    assert problem(BASE, twist(value), ZONES)
    assert problem(Checks(range={"linear.x": (-1, 1)}), twist(value), ZONES)


def test_a_field_that_has_a_limit_and_is_not_there_fails() -> None:
    assert problem(BASE, {"linear": {"x": 0.0}}, ZONES) == "there is no field angular, which has a limit"
    assert problem(BASE, "a text", ZONES)
    assert problem(BASE, None, ZONES)


def test_the_field_of_a_stamped_type_may_be_left_out() -> None:
    stamped = {"header": {"frame_id": "base"}, "twist": twist(0.3)}
    assert problem(BASE, stamped, ZONES) == "twist.linear is 0.3, at most 0.2 is allowed"
    assert not problem(BASE, {"header": {"frame_id": "base"}, "twist": twist(0.2)}, ZONES)


def test_a_float32_is_judged_as_the_number_that_was_meant() -> None:
    speed = Checks(norm={"speed": 0.2})
    assert not problem(speed, Message({"speed": ("float", 0.2)}), ZONES)  # as float32 it is 0.200000003
    assert problem(speed, Message({"speed": ("float", 0.20001)}), ZONES)
    assert problem(speed, Message({"speed": ("double", 0.2000000001)}), ZONES)
    assert problem(speed, {"speed": math.nextafter(0.2, 1)}, ZONES)


@pytest.mark.parametrize(
    ("checks", "value", "said"),
    [
        (Checks(one_of={"a": ("",)}), {"a": "x"}, "a is 'x', only '' is allowed"),
        (Checks(one_of={"a": (1,)}), {"a": True}, "only 1"),
        (Checks(one_of={"a": (True,)}), {"a": 1}, "only True"),
        (Checks(count={"a": (1, 2)}), {"a": [1, 2, 3]}, "a has 3 elements, 1 to 2 are allowed"),
        (Checks(count={"a": (1, 2)}), {"a": "xy"}, "a has -1"),
        (Checks(range={"a[].v[]": (-1, 1)}), {"a": [{"v": [0, 1]}, {"v": [0, 2]}]}, "a[1].v[1] is 2"),
        (Checks(range={"a[]": (-1, 1)}), {"a": 3}, "a is not a list"),
        (Checks(range={"a": (-1, 1)}), {"a": [[0], [0, 7]]}, "a[1][1] is 7"),
        (Checks(range={"a": (0, 2**60)}), {"a": str(2**61)}, "a is 2.30584e+18"),
    ],
)
def test_what_is_beyond_is_named_with_its_path(checks: Checks, value: Any, said: str) -> None:
    assert said in problem(checks, value, ZONES)


def pose(x: float, y: float, frame_id: str = "map") -> dict[str, Any]:
    return {"pose": {"header": {"frame_id": frame_id}, "pose": {"position": {"x": x, "y": y, "z": 0.0}}}}


@pytest.mark.parametrize(
    ("x", "y", "said"),
    [(5, 4, ""), (0.5, 0.5, ""), (0.4, 4, "from the edge"), (-1, 4, "outside"), (11, 9, "outside"),
     (math.nan, 4, "finite"), ("inf", 4, "finite"), (1e308, 1e308, "outside")],
)  # fmt: skip
def test_a_position_lies_in_the_zone_and_keeps_from_its_edge(x: Any, y: Any, said: str) -> None:
    checks = Checks(zone={"pose": "hall"})
    found = problem(checks, pose(x, y), ZONES)
    assert said in found if said else not found
    assert not problem(Checks(zone={"pose.pose.position": "hall"}), pose(5, 4), ZONES)


@pytest.mark.parametrize("frame_id", ["odom", "", "Map", "map "])
def test_a_position_in_another_frame_is_not_judged_and_fails(frame_id: str) -> None:
    assert "frame" in problem(Checks(zone={"pose": "hall"}), pose(5, 4, frame_id), ZONES)
    assert "frame" in problem(Checks(zone={"position": "hall"}), {"position": {"x": 5.0, "y": 4.0}}, ZONES)


def points(*rows: tuple[float, float]) -> dict[str, Any]:
    return {
        "points": [
            {"positions": [at], "time_from_start": {"sec": int(t), "nanosec": round(t % 1 * 1e9)}} for t, at in rows
        ]
    }


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ([(5.0, 0.0), (7.0, 1.0)], ""),
        ([(5.0, 0.0), (6.9, 1.0)], "points[1].positions[0] is reached faster than 0.5"),
        ([(4.9, 0.0)], "at least 5 s"),
        ([(5.0, 0.0), (5.0, 0.1)], "faster"),
        ([(6.0, 0.0), (5.0, 0.0)], "faster"),
        ([(5.0, math.nan), (9.0, 0.0)], "not finite"),
        ([], "no points"),
    ],
)
def test_a_trajectory_is_as_slow_as_its_points_say(rows: list[tuple[float, float]], said: str) -> None:
    found = problem(Checks(pace={"points": Pace(0.5, 5.0)}), points(*rows), ZONES)
    assert said in found if said else not found


def test_clamping_keeps_the_curvature() -> None:
    value = twist(1.0, turn=1.0)
    assert clamp(BASE, value)
    assert value["linear"]["x"] == pytest.approx(0.2, rel=1e-5)
    assert value["angular"]["z"] == pytest.approx(0.2, rel=1e-5)


def test_backwards_is_slower_where_a_range_says_so_on_the_same_curve() -> None:
    value = twist(-1.0, turn=0.5)
    assert clamp(Checks(norm={"linear": 0.4, "angular": 0.8}, range={"linear.x": (-0.1, 0.4)}), value)
    assert (value["linear"]["x"], value["angular"]["z"]) == (
        pytest.approx(-0.1, rel=1e-5),
        pytest.approx(0.05, rel=1e-5),
    )


def test_what_steers_is_bounded_by_itself() -> None:
    drive = Message({"speed": ("float", 2.0), "steering_angle": ("float", -1.0)})
    assert clamp(Checks(norm={"speed": 0.5}, range={"steering_angle": (-0.4, 0.4)}), drive)
    assert (drive.speed, drive.steering_angle) == (pytest.approx(0.5, rel=1e-5), -0.4)  # pyright: ignore


def test_what_is_within_stays_as_it_is() -> None:
    value = twist(0.2, turn=0.5)
    assert not clamp(BASE, value)
    assert value == twist(0.2, turn=0.5)


def test_whatever_is_clamped_is_within_and_what_is_not_finite_never_passes() -> None:
    chosen = random.Random(12)
    odd = [math.nan, math.inf, -math.inf, 5e-324, 1e308, -1e308, 0.2, -0.0, math.nextafter(0.2, 1)]
    for _ in range(2_000):
        numbers = [chosen.choice(odd) if chosen.random() < 0.2 else chosen.uniform(-2, 2) for _ in range(6)]
        parts = {
            "linear": dict(zip("xyz", numbers[:3], strict=True)),
            "angular": dict(zip("xyz", numbers[3:], strict=True)),
        }
        message, before = as_message(parts), problem(BASE, parts, ZONES)
        assert bool(before) == bool(problem(BASE, message, ZONES))
        clamp(BASE, message)
        after = as_object(message)
        if problem(BASE, message, ZONES):
            assert not all(map(math.isfinite, numbers))
        else:
            assert math.hypot(*after["linear"].values()) <= 0.2
            assert math.hypot(*after["angular"].values()) <= 0.5
