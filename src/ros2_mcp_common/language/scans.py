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


# No scanner tells more than two turns in one message; one whose steps are in degrees would tell 57.
_MOST_TURN = 2 * _TURN
# By how many rays, or by which share of them, the header may be wrong: drivers count the last ray in or not, and round
# their steps. Bearings are then wrong by 7° at most.
_WRONG_RAYS, _WRONG_SHARE = 2, 0.02
# A number of ranges that is worth telling.
_MOST_TOLD = 1e6


class NoRange(Exception):
    """The scan does not tell the range that was asked for: the message says why."""


def why_no_bearings(first: float, last: float, step: float, count: int) -> str:
    """A sentence on why nobody knows where the rays of a scan point; empty where that is known.

    Args:
        first: `angle_min` of the scan, rad.
        last: its `angle_max`, rad; 0, and what is no number, count as not filled in.
        step: its `angle_increment`, rad.
        count: how many ranges it has.
    """
    if not (math.isfinite(first) and math.isfinite(step)):
        told = f"angle_min is {first:g} rad, angle_increment {step:g} rad".replace("nan", "NaN")
        return f"The scan has no bearings: {told} for {count} ranges."
    if count < 2:
        return ""
    if step == 0:
        return f"The scan has no bearings: angle_increment is 0 for {count} ranges, its driver has not filled it in."
    if abs(step) * (count - 1) > _MOST_TURN:
        turns = f"{count} ranges in steps of {step:.4g} rad are {abs(step) * count / _TURN:.3g} turns"
        return f"The scan has no bearings: {turns}. angle_increment is in radians, not in degrees."
    if not last or not math.isfinite(last):
        return ""
    told_count = (last - first) / step + 1
    if abs(told_count - count) <= max(_WRONG_RAYS, _WRONG_SHARE * count):
        return ""
    header = f"{first:.4g} to {last:.4g} rad in steps of {step:.4g}"
    tells = f"{round(told_count)} ranges" if 0 < told_count < _MOST_TOLD else "another number"
    return f"The scan has no bearings: it has {count} ranges, and its header tells {tells} ({header})."


def nearest_range(scan: Any, from_deg: float, to_deg: float) -> float:
    """The smallest range in m of a scan from one angle counterclockwise to another; infinite where nothing is in sight.

    What the definition of LaserScan and REP 117 say of a range holds: NaN, and what is smaller than `range_min`, is no
    measurement; `-inf` is too close to be measured, here 0; `inf`, and what is larger than `range_max`, is nothing.

    Raises:
        NoRange: where nobody knows where its rays point, no ray points there, or none of those that do has measured
            anything.
    """
    ranges = scan.ranges
    if why := why_no_bearings(scan.angle_min, scan.angle_max, scan.angle_increment, len(ranges)):
        raise NoRange(f"{why[:1].lower()}{why[1:]}")
    if not (math.isfinite(from_deg) and math.isfinite(to_deg)):
        raise NoRange("the angles that are asked for are no numbers.")
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
