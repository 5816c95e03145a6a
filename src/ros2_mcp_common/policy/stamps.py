"""Stamps that take effect: the `header.stamp` of a trajectory is when it begins. Needs no ROS.

With a stamp in the past, the joints jump to where they would be by now. So such a stamp has to be zero, which means *on
arrival*, or within 1 s of now; then it is set to zero, because transmission takes time, and an approval takes longer.
Values are JSON objects or messages decoded by rclpy.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from ros2_mcp_common.policy.field_values import fields_of, get, is_list, number_at

# The tolerated difference from now: for the clocks of two machines and the duration of a call. Any other begin is
# refused.
HONEST_S = 1.0
NS_PER_S = 1_000_000_000
_OF_TRAJECTORY = {"header", "joint_names", "points"}


def trajectories_in(value: Any, shown: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the trajectories in a value, each with its path."""
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
    """Yield the stamps in a value that say when a trajectory begins, each with its path; also stamps that are zero."""
    for shown, trajectory in trajectories_in(value):
        header = get(trajectory, "header")
        if "stamp" in fields_of(header):
            yield f"{shown}.header.stamp".lstrip("."), get(header, "stamp")


def time_ns(stamp: Any) -> int:
    """Return a stamp in ns. Raise `Unfit` if the value is no stamp."""
    return int(number_at(stamp, "sec", "sec")) * NS_PER_S + int(number_at(stamp, "nanosec", "nanosec"))


def problem(value: Any, now_ns: int) -> str:
    """Return which start time of a trajectory is neither zero nor within 1 s of `now_ns`, in words; "" if none."""
    for path, stamp in acting_stamps(value):
        away_s = (time_ns(stamp) - now_ns) / NS_PER_S
        if time_ns(stamp) and not abs(away_s) <= HONEST_S:
            when = f"{abs(away_s):.1f} s {'ago' if away_s < 0 else 'ahead'}"
            return f"{path} is {when}: a trajectory begins on arrival, with a stamp of zero or within 1 s of now"
    return ""


def zero(value: Any) -> bool:
    """Set the start time of every trajectory to zero, in place. Return whether one had another value."""
    found = [stamp for _, stamp in acting_stamps(value) if time_ns(stamp)]
    for stamp in found:
        if isinstance(stamp, dict):
            stamp["sec"] = stamp["nanosec"] = 0
        else:
            stamp.sec = stamp.nanosec = 0
    return bool(found)
