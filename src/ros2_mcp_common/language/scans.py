"""Ranges of a laser scan by their angles. Needs no ROS: any object with the fields of a LaserScan will do.

Angles are those of the scan's own frame: 0 is its x axis, counterclockwise is positive.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

LASER_SCAN = "sensor_msgs/msg/LaserScan"
_TURN = 2 * math.pi
# A ray stands for half a step to both of its sides; a little more, so that rounding leaves no gap between two rays.
_HALF_A_STEP = 0.5 * (1 + 1e-6)


class NoRange(Exception):
    """The scan does not tell the range that was asked for: the message says why."""


def nearest_range(scan: Any, from_deg: float, to_deg: float) -> float:
    """The smallest range in m of a scan from one angle counterclockwise to another; infinite where nothing is in sight.

    What the definition of LaserScan and REP 117 say of a range holds: NaN, and what is smaller than `range_min`, is no
    measurement; `-inf` is too close to be measured, here 0; `inf`, and what is larger than `range_max`, is nothing.

    Raises:
        NoRange: where no ray points there, or none of those that do has measured anything.
    """
    numbers = (from_deg, to_deg, scan.angle_min, scan.angle_increment)
    if not all(map(math.isfinite, numbers)) or not scan.angle_increment:
        raise NoRange("the scan's angles, or those that are asked for, are no numbers.")
    ranges = scan.ranges
    rays = _rays(from_deg, to_deg, scan.angle_min, scan.angle_increment, len(ranges))
    if not rays:
        first, last = (scan.angle_min + scan.angle_increment * number for number in (0, max(len(ranges) - 1, 0)))
        sees = f"{math.degrees(first):.0f}° to {math.degrees(last):.0f}°" if len(ranges) else "nothing"
        raise NoRange(f"no ray points there: the scan sees {sees}.")
    found = (_seen(float(ranges[ray]), scan.range_min, scan.range_max) for ray in rays)
    measured = [each for each in found if not math.isnan(each)]
    if not measured:
        raise NoRange("no ray that points there has measured anything.")
    return min(measured)


def _seen(found: float, least: float, most: float) -> float:
    """What one range means, in m; NaN for no measurement."""
    if found == -math.inf:
        return 0.0
    if found < least:
        return math.nan
    return math.inf if found > most > 0 else found  # some drivers leave the largest range at 0


# A scan mostly keeps its shape; an entry is a list of some hundred numbers.
@lru_cache(maxsize=64)
def _rays(from_deg: float, to_deg: float, first: float, step: float, count: int) -> Sequence[int]:
    """The rays of a scan from an angle counterclockwise to another, by their numbers; first and step in rad."""
    margin = abs(step) * _HALF_A_STEP
    width = _TURN if abs(to_deg - from_deg) >= 360 else math.radians(to_deg - from_deg) % _TURN
    start = math.radians(from_deg) - margin
    return [number for number in range(count) if (first + number * step - start) % _TURN <= width + 2 * margin]
