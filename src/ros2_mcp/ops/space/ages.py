"""The age of a message, from its header stamp or from when it was sent or received."""

from __future__ import annotations

from typing import Any

from ros2_mcp.model.samples import Sample

_LONGEST_AGE_S = 1e6
"""Longest plausible age: beyond it, stamp and clock differ (one is simulated time) or the stamp is not set."""


def stamp_ns(header: Any) -> int:
    """Return the stamp of a `std_msgs/msg/Header` in ns; 0 if it is not set."""
    return header.stamp.sec * 1_000_000_000 + header.stamp.nanosec


def since_s(stamp_ns: int | None, now_ns: int) -> float | None:
    """Return the age of a stamp in s, at least 0; None if the stamp is 0 or comes from another clock (more than 1 s
    ahead, or older than 1e6 s).
    """
    if not stamp_ns:
        return None
    age_s = (now_ns - stamp_ns) / 1e9
    return round(max(age_s, 0.0), 3) if -1 < age_s < _LONGEST_AGE_S else None


def age_of(header: Any, sample: Sample, now_ns: int) -> float | None:
    """Return the age of a message in s: from its header stamp, else from its source timestamp (a latched message is
    sent long before it is received), else from its time of receipt. None if no time is plausible.
    """
    of = (stamp_ns(header), sample.source_ns, sample.received_ns)
    return next((age_s for at_ns in of if (age_s := since_s(at_ns, now_ns)) is not None), None)
