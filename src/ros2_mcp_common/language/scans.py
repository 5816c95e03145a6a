"""Ranges of a laser scan by their angles. Needs no ROS: any object with the fields of a LaserScan will do.

Angles are those of the scan's own frame: 0 is its x axis, counterclockwise is positive.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

from ros2_mcp_common.finite import not_finite

LASER_SCAN = "sensor_msgs/msg/LaserScan"
_TURN = 2 * math.pi
# A ray stands for half a step to both of its sides; a little more, so that rounding leaves no gap between two rays.
_HALF_A_STEP = 0.5 * (1 + 1e-6)


# No scanner tells more than two turns in one message; one whose steps are in degrees would tell 57.
_MOST_TURN_RAD = 2 * _TURN


class NoRange(Exception):
    """The scan does not tell the range that was asked for: the message says why."""


def no_bearings(scan: Any) -> str:
    """Why the beams of a scan have no bearings, in words; empty where they have."""
    count, step = len(scan.ranges), scan.angle_increment
    if why := not_finite(scan, "angle_min", "angle_increment"):
        return why
    if not step and count > 1:
        return f"angle_increment is 0 for {count} ranges"
    if abs(step) * (count - 1) > _MOST_TURN_RAD:
        return f"{count} ranges in steps of {step:.4g} rad are {abs(step) * count / _TURN:.3g} turns"
    return ""


def limits_of(scan: Any) -> tuple[float, float]:
    """The least and the greatest range (m) that a scan says it can measure; 0 and infinite where it has none that is a
    positive number: some drivers leave them at 0.
    """
    least, most = float(scan.range_min), float(scan.range_max)
    return (
        least if math.isfinite(least) and least > 0 else 0.0,
        most if math.isfinite(most) and most > 0 else math.inf,
    )


def nearest_range(scan: Any, from_deg: float, to_deg: float) -> float:
    """The smallest range in m of a scan from one angle counterclockwise to another; infinite where nothing is in sight.

    What the definition of LaserScan and REP 117 say of a range holds: NaN, and what is smaller than `range_min`, is no
    measurement; `-inf` is too close to be measured, here 0; `inf`, and what is larger than `range_max`, is nothing.

    Raises:
        NoRange: where no ray points there, or none of those that do has measured anything.
    """
    if not (math.isfinite(from_deg) and math.isfinite(to_deg)):
        raise NoRange("the angles that are asked for are not finite.")
    if why := no_bearings(scan):
        raise NoRange(f"the scan has no bearings: {why}.")
    ranges = scan.ranges
    rays = _rays(from_deg, to_deg, scan.angle_min, scan.angle_increment, len(ranges))
    if not rays:
        first, last = (scan.angle_min + scan.angle_increment * number for number in (0, max(len(ranges) - 1, 0)))
        sees = f"{math.degrees(first):.0f}° to {math.degrees(last):.0f}°" if len(ranges) else "nothing"
        raise NoRange(f"no ray points there: the scan sees {sees}.")
    least, most = limits_of(scan)
    found = (_seen(float(ranges[ray]), least, most) for ray in rays)
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
    return math.inf if found > most else found


# A scan mostly keeps its shape; an entry is a list of some hundred numbers.
@lru_cache(maxsize=64)
def _rays(from_deg: float, to_deg: float, first: float, step: float, count: int) -> Sequence[int]:
    """The rays of a scan from an angle counterclockwise to another, by their numbers; first and step in rad."""
    margin = abs(step) * _HALF_A_STEP
    width = _TURN if abs(to_deg - from_deg) >= 360 else math.radians(to_deg - from_deg) % _TURN
    start = math.radians(from_deg) - margin
    return [number for number in range(count) if (first + number * step - start) % _TURN <= width + 2 * margin]
