"""Ranges of a laser scan by angle. Needs no ROS: any object with the fields of a LaserScan will do.

Angles are in the frame of the scan: 0 is its x axis, counterclockwise is positive.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

from ros2_mcp_common.finite import not_finite

LASER_SCAN = "sensor_msgs/msg/LaserScan"
_TURN = 2 * math.pi
# A ray covers half a step on both sides, and a little more, so that rounding leaves no gap between two rays.
_HALF_A_STEP = 0.5 * (1 + 1e-6)


# No scanner tells more than two turns in one message; one whose steps are in degrees would tell 57.
_MOST_TURN_RAD = 2 * _TURN
# By how many rays, or by which share of them, the header may be wrong: drivers count the last ray in or not, and round
# their steps. Bearings are then wrong by 7° at most.
_WRONG_RAYS, _WRONG_SHARE = 2, 0.02
# A number of ranges that is worth telling.
_MOST_TOLD = 1e6


class NoRange(Exception):
    """Raised if the scan has no range at the requested angles; the text says why."""


def no_bearings(scan: Any) -> str:
    """Return why the beams of a scan have no bearings, as a sentence; empty if they have."""
    count, step = len(scan.ranges), scan.angle_increment
    if why := not_finite(scan, "angle_min", "angle_increment"):
        return why
    if not step and count > 1:
        return f"angle_increment is 0 for {count} ranges"
    if abs(step) * (count - 1) > _MOST_TURN_RAD:
        return f"{count} ranges in steps of {step:.4g} rad are {abs(step) * count / _TURN:.3g} turns"
    return _contradiction(scan.angle_min, scan.angle_max, step, count)


def _contradiction(first: float, last: float, step: float, count: int) -> str:
    """Return how the number of ranges contradicts the header; empty if it agrees, or if `angle_max` was left at 0."""
    if count < 2 or not last or not math.isfinite(last):
        return ""
    told_count = (last - first) / step + 1
    if abs(told_count - count) <= max(_WRONG_RAYS, _WRONG_SHARE * count):
        return ""
    tells = f"{round(told_count)}" if 0 < told_count < _MOST_TOLD else "another number"
    return f"it has {count} ranges, and the header tells {tells} ({first:.4g} to {last:.4g} rad in steps of {step:.4g})"


def limits_of(scan: Any) -> tuple[float, float]:
    """Return the minimum and maximum range (m) of a scan; 0 and infinity for a limit that is not a positive number:
    some drivers leave them at 0.
    """
    least, most = float(scan.range_min), float(scan.range_max)
    return (
        least if math.isfinite(least) and least > 0 else 0.0,
        most if math.isfinite(most) and most > 0 else math.inf,
    )


def nearest_range(scan: Any, from_deg: float, to_deg: float) -> float:
    """Return the smallest range of a scan in m, from one angle counterclockwise to another;
    infinite if nothing is in range.

    Follows LaserScan and REP 117: NaN, and a range below `range_min`, is no measurement; `-inf` is too close to be
    measured, here 0; `inf`, and a range above `range_max`, means that nothing was detected.

    Raises:
        NoRange: if the scan has no bearings, no ray points there, or none of those that do has a measurement.
    """
    if not (math.isfinite(from_deg) and math.isfinite(to_deg)):
        raise NoRange("the requested angles are not finite.")
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
    """Return the meaning of one range in m; NaN for no measurement."""
    if found == -math.inf:
        return 0.0
    if found < least:
        return math.nan
    return math.inf if found > most else found


# Scans of a sensor mostly have the same angles; an entry is a list of some hundred numbers.
@lru_cache(maxsize=64)
def _rays(from_deg: float, to_deg: float, first: float, step: float, count: int) -> Sequence[int]:
    """Return the indices of the rays from one angle counterclockwise to another; `first` and `step` are in rad."""
    margin = abs(step) * _HALF_A_STEP
    width = _TURN if abs(to_deg - from_deg) >= 360 else math.radians(to_deg - from_deg) % _TURN
    start = math.radians(from_deg) - margin
    return [number for number in range(count) if (first + number * step - start) % _TURN <= width + 2 * margin]
