"""Unix times as text."""

from __future__ import annotations

from datetime import datetime, timezone


def iso_time(unix_ns: int) -> str:
    """A Unix time in nanoseconds as ISO 8601 in UTC with microseconds."""
    date = datetime.fromtimestamp(unix_ns // 1000 / 1e6, tz=timezone.utc)
    return date.isoformat(timespec="microseconds").replace("+00:00", "Z")
