"""Moments in a recording, as people write them: ISO 8601 with a zone, or relative to the recording."""

from __future__ import annotations

import re
from datetime import datetime

from ros2_mcp.bags.stored import FOREVER, Span
from ros2_mcp.model.errors import BadValue

_RELATIVE = re.compile(
    r"(?P<from>first|last)?\s*(?P<number>\d+(?:\.\d+)?)\s*"
    r"(?P<unit>ms|milliseconds?|s|sec|seconds?|min|minutes?|h|hours?)(?:\s+ago)?",
    re.IGNORECASE,
)
_SECONDS = {"ms": 0.001, "mi": 60.0, "m": 60.0, "s": 1.0, "h": 3600.0}
_HINT = 'Write it like 2026-11-21T03:00:00Z, 2026-11-21T03:00:00.5+01:00, "last 30 s" or "first 2 min".'


def span_of(start: str, end: str, first_ns: int, last_ns: int) -> Span:
    """The time between two moments of a recording from `first_ns` to `last_ns`; empty is its beginning or its end.

    `last 30 s` and `30 s ago` count back from the recording's end, `first 30 s` from its beginning.

    Raises:
        BadValue: if one is not written like a moment, or the end lies before the start.
    """
    start_ns = moment_ns("start", start, first_ns, last_ns) if start.strip() else 0
    end_ns = moment_ns("end", end, first_ns, last_ns) if end.strip() else FOREVER
    if end_ns < start_ns:
        raise BadValue("end", f"{end!r} is before {start!r}.")
    return Span(None, start_ns, end_ns)


def moment_ns(name: str, text: str, first_ns: int, last_ns: int) -> int:
    """One moment as Unix time in nanoseconds; raises as `span_of`."""
    relative = _RELATIVE.fullmatch(text.strip())
    if relative is None:
        return _absolute_ns(name, text.strip())
    unit = relative["unit"].lower()
    scale = _SECONDS["ms" if unit == "ms" or unit.startswith("milli") else unit[0]]
    away_ns = round(float(relative["number"]) * scale * 1e9)
    return first_ns + away_ns if (relative["from"] or "").lower() == "first" else last_ns - away_ns


def _absolute_ns(name: str, text: str) -> int:
    whole, fraction = text, ""
    if found := re.search(r"[.,](\d{1,9})\d*", text):
        whole, fraction = text[: found.start()] + text[found.end() :], found[1]
    try:
        moment = datetime.fromisoformat(re.sub(r"[zZ]$", "+00:00", whole))
    except ValueError as error:
        raise BadValue(name, f"{text!r} is not a moment.", _HINT) from error
    if moment.tzinfo is None:
        raise BadValue(name, f"{text!r} has no time zone.", "Add Z for UTC, or an offset such as +01:00.")
    return round(moment.timestamp()) * 1_000_000_000 + int(fraction.ljust(9, "0") or 0)
