"""Ranges of a laser scan by their angles."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass, field
from itertools import pairwise

import pytest

from ros2_mcp_common.language.scans import NoRange, nearest_range


@dataclass
class Scan:
    angle_min: float = -math.pi / 2
    angle_increment: float = math.pi / 180
    range_min: float = 0.1
    range_max: float = 10.0
    ranges: list[float] = field(default_factory=lambda: [5.0] * 181)
    angle_max: float = 0.0


def seen(**at_degrees: float) -> Scan:
    """A scan from -90° to 90° in which something stands at these angles: `m30` is -30°, `p30` is 30°."""
    scan = Scan()
    for name, found in at_degrees.items():
        scan.ranges[90 + int(name[1:]) * (1 if name[0] == "p" else -1)] = found
    return scan


@pytest.mark.parametrize(
    ("from_deg", "to_deg", "expected"),
    [
        (-20, 20, 2.0),
        (20, 40, 1.0),
        (30, 30, 1.0),
        (30.4, 30.4, 1.0),
        (-90, -60, 5.0),
        (-90, 90, 1.0),
        (-40, 29.4, 2.0),
    ],
)
def test_the_nearest_thing_between_two_angles_is_found(from_deg: float, to_deg: float, expected: float) -> None:
    assert nearest_range(seen(p30=1.0, m10=2.0), from_deg, to_deg) == expected


def test_a_sector_goes_counterclockwise_and_may_lead_through_the_back() -> None:
    around = Scan(angle_min=0.0, angle_increment=math.radians(1), ranges=[5.0] * 360)
    around.ranges[180], around.ranges[0] = 1.0, 2.0
    assert nearest_range(around, 170, -170) == 1.0
    assert nearest_range(around, -170, 170) == 2.0
    assert nearest_range(around, -180, 180) == nearest_range(around, 0, 360) == 1.0


def test_a_scan_that_turns_clockwise_is_read_by_its_angles() -> None:
    turned = Scan(angle_min=math.pi / 2, angle_increment=-math.pi / 180)
    turned.ranges[0] = 1.0
    assert (nearest_range(turned, 80, 100), nearest_range(turned, -90, -80)) == (1.0, 5.0)


@pytest.mark.parametrize(
    ("found", "expected"),
    [(math.nan, 5.0), (0.0, 5.0), (0.05, 5.0), (-math.inf, 0.0), (0.1, 0.1), (math.inf, 5.0), (11.0, 5.0)],
)
def test_what_is_no_measurement_is_left_out_and_too_close_is_zero(found: float, expected: float) -> None:
    assert nearest_range(seen(p0=found), -1, 1) == expected


def test_what_is_free_is_infinitely_far() -> None:
    assert nearest_range(Scan(ranges=[math.inf] * 181), -5, 5) == math.inf
    assert nearest_range(Scan(ranges=[12.0] * 181), -5, 5) == math.inf
    assert nearest_range(Scan(range_max=0.0, ranges=[12.0] * 181), -5, 5) == 12.0


@pytest.mark.parametrize(
    ("scan", "says"),
    [
        (Scan(ranges=[]), "sees nothing"),
        (Scan(angle_increment=0.0), "no bearings: angle_increment is 0"),
        (Scan(angle_min=math.nan), "no bearings: angle_min is NaN"),
        (Scan(angle_max=math.pi), "181 ranges, and the header tells 271"),
        (Scan(ranges=[0.0] * 181), "has measured"),
    ],
)
def test_a_scan_that_tells_nothing_says_why(scan: Scan, says: str) -> None:
    with pytest.raises(NoRange, match=says):
        nearest_range(scan, -5, 5)


def test_an_angle_that_the_scan_does_not_see_says_what_it_sees() -> None:
    with pytest.raises(NoRange, match="-90° to 90°"):
        nearest_range(Scan(), 120, 150)


def test_no_ray_is_forgotten_between_two_neighbouring_sectors() -> None:
    choose = random.Random(5)
    for _ in range(200):
        count = choose.randint(2, 400)
        step = math.radians(choose.uniform(0.2, 359 / count)) * choose.choice((1, -1))
        scan = Scan(choose.uniform(-7, 7), step, ranges=[choose.uniform(0.5, 9) for _ in range(count)])
        first, middle = (math.degrees(scan.angle_min + step * ray) for ray in (0, choose.randrange(count)))
        last = math.degrees(scan.angle_min + step * (count - 1))
        ends = (first, middle, last) if step > 0 else (last, middle, first)
        parts = [nearest_range(scan, *between) for between in pairwise(ends)]
        assert min(parts) == min(scan.ranges)
