"""Stamps that act: a trajectory's `header.stamp` is when it begins. One of the past makes the joints jump to where they
would be by now. Needs no ROS.

Such a stamp has to be zero, which means *on arrival*, or within a second of now, where it is set to zero: what is
underway takes its time, and an approval longer. Values are JSON objects, or messages that rclpy decoded.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from ros2_mcp_common.policy.field_values import fields_of, get, is_list, number_at

# Clocks of two machines, and the time of a call. Whoever means another beginning than *now* is refused.
HONEST_S = 1.0
NS_PER_S = 1_000_000_000
_OF_TRAJECTORY = {"header", "joint_names", "points"}


def trajectories_in(value: Any, shown: str = "") -> Iterator[tuple[str, Any]]:
    """The trajectories in a value, with their paths."""
    names = fields_of(value)
    if set(names) >= _OF_TRAJECTORY:
        yield shown, value
        return
    for name in names:
        below = get(value, name)
        if fields_of(below):
            yield from trajectories_in(below, f"{shown}.{name}".lstrip("."))
        elif is_list(below) and len(below) and fields_of(below[0]):
            for place, element in enumerate(below):
                yield from trajectories_in(element, f"{shown}.{name}[{place}]".lstrip("."))


def acting_stamps(value: Any) -> Iterator[tuple[str, Any]]:
    """The stamps in a value that say when a trajectory begins, with their paths; also such as are zero."""
    for shown, trajectory in trajectories_in(value):
        header = get(trajectory, "header")
        if "stamp" in fields_of(header):
            yield f"{shown}.header.stamp".lstrip("."), get(header, "stamp")


def time_ns(stamp: Any) -> int:
    """A stamp in ns; raises `Unfit` for what is none."""
    return int(number_at(stamp, "sec", "sec")) * NS_PER_S + int(number_at(stamp, "nanosec", "nanosec"))


def problem(value: Any, now_ns: int) -> str:
    """Which acting stamp is neither zero nor within a second of now, in words; empty if none."""
    for path, stamp in acting_stamps(value):
        away_s = (time_ns(stamp) - now_ns) / NS_PER_S
        if time_ns(stamp) and not abs(away_s) <= HONEST_S:
            when = f"{abs(away_s):.1f} s {'ago' if away_s < 0 else 'ahead'}"
            return f"{path} is {when}: a trajectory begins on arrival, with a stamp of zero or within 1 s of now"
    return ""


def zero(value: Any) -> bool:
    """Sets every acting stamp to zero, in place; whether one was another."""
    found = [stamp for _, stamp in acting_stamps(value) if time_ns(stamp)]
    for stamp in found:
        if isinstance(stamp, dict):
            stamp["sec"] = stamp["nanosec"] = 0
        else:
            stamp.sec = stamp.nanosec = 0
    return bool(found)
