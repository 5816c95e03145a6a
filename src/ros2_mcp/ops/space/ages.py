"""How old a message is, by its own clock or by when it came."""

from __future__ import annotations

from typing import Any

from ros2_mcp.model.samples import Sample

_LONGEST_AGE_S = 1e6
"""Between a stamp and now: more means that one of both is simulated time, or not filled in."""


def stamp_ns(header: Any) -> int:
    """The stamp of a header, in ns; 0 where it is not filled in."""
    return header.stamp.sec * 1_000_000_000 + header.stamp.nanosec


def since_s(stamp_ns: int | None, now_ns: int) -> float | None:
    """How long ago that was; None where the stamp is of another clock."""
    if not stamp_ns:
        return None
    age_s = (now_ns - stamp_ns) / 1e9
    return round(max(age_s, 0.0), 3) if -1 < age_s < _LONGEST_AGE_S else None


def age_of(header: Any, sample: Sample, now_ns: int) -> float | None:
    """By the message's stamp, else by when it was sent (if latched earlier than it came), else by when it came."""
    of = (stamp_ns(header), sample.source_ns, sample.received_ns)
    return next((age_s for at_ns in of if (age_s := since_s(at_ns, now_ns)) is not None), None)
