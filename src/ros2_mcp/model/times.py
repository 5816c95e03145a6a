"""Unix times as text."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timezone


def iso_time(unix_ns: int) -> str:
    """Format a Unix time in nanoseconds as ISO 8601 in UTC with microseconds."""
    date = datetime.fromtimestamp(unix_ns // 1000 / 1e6, tz=timezone.utc)
    return date.isoformat(timespec="microseconds").replace("+00:00", "Z")


def seconds_from_start(unix_ns: int, began_ns: int | None) -> float | None:
    """Return the seconds since the beginning of a recording; None without a beginning, for live data.

    Rounded down to milliseconds: used as `start`, it still includes the message of that time.
    """
    return (unix_ns - began_ns) // 1_000_000 / 1000 if began_ns is not None else None


def recorded_time(unix_ns: int, began_ns: int | None = None) -> str:
    """Format a time by `iso_time`; in a recording also with the seconds since its beginning: `… (12.3 s in)`.

    `began_ns` is None for live data. The seconds can be given as `start`.
    """
    seconds = seconds_from_start(unix_ns, began_ns)
    if seconds is None:
        return iso_time(unix_ns)
    written = f"{seconds:.3f}".rstrip("0").rstrip(".")
    return f"{iso_time(unix_ns)} ({written} s in)"


def both_times(unix_ns: int, zero_ns: int) -> str:
    """Format a time in milliseconds for people: seconds since another time, and absolute."""
    return f"{(unix_ns - zero_ns) / 1e9:.3f} s ({iso_time(unix_ns)[:-4]}Z)"


@dataclass(frozen=True, slots=True)
class Outage:
    """An interval during which a remote robot was unreachable.

    `began_at` is when it last responded (monotonic clock, s).
    """

    began_at: float
    lasted_s: float
