"""What a laser scan means: nearest obstacle and free distances, seen from the base, whatever the mount."""

from __future__ import annotations

import math
from typing import Any

import pytest

from ros2_mcp.model.errors import BadData
from ros2_mcp.model.meanings import SECTORS, ScanMeaning
from ros2_mcp.model.poses import Pose, planar
from ros2_mcp.values.check import check
from ros2_mcp.values.definitions import Definitions
from ros2_mcp.world.scans import scan_meaning

BEAMS = 360
INF, NAN = math.inf, math.nan


@pytest.fixture
def scan(definitions: Definitions) -> Any:
    """A scan all around, one beam a degree from -180° on, with this range at each given degree and 4 m else."""

    def made(at: dict[int, float] | None = None, other: float = 4.0, **more: Any) -> Any:
        ranges = [(at or {}).get(degree, other) for degree in range(-180, 180)]
        value = {
            "header": {"frame_id": "laser"},
            "angle_min": -math.pi,
            "angle_max": math.pi,
            "angle_increment": math.radians(1),
            "range_min": 0.1,
            "range_max": 10.0,
            "ranges": [str(one) if not math.isfinite(one) else one for one in ranges],
        }
        return check(definitions, "sensor_msgs/msg/LaserScan", {**value, **more})

    return made


def mounted(x: float = 0.0, yaw_deg: float = 0.0, roll_deg: float = 0.0) -> Pose:
    """A scanner at (x, 0) of the base, rolled about its own x and then turned about z."""
    roll = math.radians(roll_deg) / 2
    return planar(x, 0.0, math.radians(yaw_deg)) @ Pose(rotation=(math.sin(roll), 0.0, 0.0, math.cos(roll)))


def nearest(meaning: ScanMeaning) -> tuple[float | None, float | None]:
    return meaning.nearest_m, meaning.nearest_bearing_deg


def test_the_nearest_obstacle_has_its_distance_bearing_and_place(scan: Any) -> None:
    meaning = scan_meaning(scan({90: 0.5}))
    assert nearest(meaning) == pytest.approx((0.5, 90.0))
    assert (meaning.nearest_x_m, meaning.nearest_y_m) == pytest.approx((0.0, 0.5))
    assert "Nearest obstacle 0.50 m 90° to the left (left)." in str(meaning)


@pytest.mark.parametrize(
    ("degree", "side"), list(zip((0, 45, 90, 135, -180, -135, -90, -45), SECTORS, strict=True)), ids=SECTORS
)
def test_each_side_has_its_free_distance(scan: Any, degree: int, side: str) -> None:
    free = scan_meaning(scan({degree: 1.5})).free_m
    assert free == {name: pytest.approx(1.5 if name == side else 4.0) for name in SECTORS}


def test_distances_are_those_from_the_base(scan: Any) -> None:
    meaning = scan_meaning(scan({0: 1.0}), mounted(x=0.3), "base_link")
    assert (meaning.seen_from, meaning.is_base) == ("base_link", True)
    assert nearest(meaning) == pytest.approx((1.3, 0.0))


def test_a_scanner_that_looks_backwards_sees_what_is_behind(scan: Any) -> None:
    meaning = scan_meaning(scan({0: 1.0, 90: 2.0}), mounted(yaw_deg=180), "base_link")
    assert meaning.nearest_m == pytest.approx(1.0) and abs(meaning.nearest_bearing_deg or 0) == pytest.approx(180)
    assert "straight behind (rear)" in str(meaning)
    assert meaning.free_m["right"] == pytest.approx(2.0)


def test_a_scanner_that_hangs_upside_down_does_not_mix_up_left_and_right(scan: Any) -> None:
    meaning = scan_meaning(scan({90: 0.5}), mounted(roll_deg=180), "base_link")
    assert nearest(meaning) == pytest.approx((0.5, -90.0))
    assert "tilted" not in meaning.note


def test_a_tilted_scanner_says_that_it_may_see_the_floor(scan: Any) -> None:
    assert "tilted by 20°" in scan_meaning(scan(), mounted(roll_deg=20), "base_link").note


def test_without_a_mount_the_frame_is_the_scanners_own_and_it_is_said(scan: Any) -> None:
    meaning = scan_meaning(scan())
    assert (meaning.seen_from, meaning.is_base) == ("laser", False)
    assert "its mount on the base is unknown" in meaning.note


def test_no_echo_is_free_as_far_as_the_scanner_sees(scan: Any) -> None:
    meaning = scan_meaning(scan(other=INF))
    assert nearest(meaning) == (None, None)
    assert set(meaning.free_m.values()) == {10.0}
    assert "No obstacle within 10.00 m in its field of view." in str(meaning)


def test_a_range_beyond_the_greatest_one_is_no_echo(scan: Any) -> None:
    assert scan_meaning(scan(other=65.0)).nearest_m is None


@pytest.mark.parametrize("invalid", [NAN, 0.0, 0.05, -1.0])
def test_invalid_beams_are_neither_free_nor_an_obstacle(scan: Any, invalid: float) -> None:
    meaning = scan_meaning(scan(dict.fromkeys(range(60, 120), invalid)))
    assert meaning.free_m["left"] is None and meaning.free_m["right"] == pytest.approx(4.0)
    assert meaning.invalid == 60 and "60 of 360 beams are invalid." in meaning.note
    assert "not seen: left" in str(meaning)


def test_what_is_too_close_to_be_measured_is_the_nearest(scan: Any) -> None:
    meaning = scan_meaning(scan({-45: -INF}))
    assert nearest(meaning) == pytest.approx((0.1, -45.0))
    assert "1 beam hit something nearer than the scanner can measure" in meaning.note


def test_a_scan_of_the_front_alone_says_nothing_of_the_rear(scan: Any) -> None:
    front = [2.0] * 91
    meaning = scan_meaning(scan(angle_min=-math.pi / 4, angle_max=math.pi / 4, ranges=front))
    seen = {name for name, metres in meaning.free_m.items() if metres is not None}
    assert seen == {"front", "front left", "front right"}


def test_a_scan_without_limits_is_taken_as_far_as_it_saw(scan: Any) -> None:
    meaning = scan_meaning(scan({0: 7.0}, range_min=0.0, range_max=0.0))
    assert meaning.range_max_m == pytest.approx(7.0) and meaning.nearest_m == pytest.approx(4.0)


def test_an_empty_scan_and_one_without_valid_beams_say_so(scan: Any) -> None:
    for broken in (scan(ranges=[]), scan(other=NAN)):
        assert "No side is covered by valid beams." in str(scan_meaning(broken))


def test_angles_that_are_no_numbers_are_refused(scan: Any) -> None:
    with pytest.raises(BadData, match="angle_min is NaN"):
        scan_meaning(scan(angle_min="nan"))
