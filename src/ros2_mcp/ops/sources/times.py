"""Times in a recording, as people write them: ISO 8601 with a zone, or relative to the recording."""

from __future__ import annotations

import re
from datetime import datetime, timezone

from ros2_mcp.bags.stored import FOREVER, Span
from ros2_mcp.model.errors import BadValue

_RELATIVE = re.compile(
    r"(?P<before>first|last)?\s*(?P<number>\d+(?:\.\d+)?)\s*"
    r"(?P<unit>ms|milliseconds?|s|sec|seconds?|min|minutes?|h|hours?)(?:\s+(?P<after>ago|in))?",
    re.IGNORECASE,
)
_SECONDS = {"ms": 0.001, "mi": 60.0, "m": 60.0, "s": 1.0, "h": 3600.0}
_FRACTION = re.compile(r"[.,](\d{1,9})\d*")
_EARLIEST = -(2**63)
_HINT = 'Write it like 2026-11-21T03:00:00Z, 2026-11-21T03:00:00.5+01:00, "last 30 s" or "2 min in".'


def span_of(start: str, end: str, first_ns: int, last_ns: int) -> Span:
    """The span between two times of a recording from `first_ns` to `last_ns`; empty is its beginning or its end.

    `last 30 s` and `30 s ago` count back from the recording's end; `2 min in` is the time two minutes after its
    beginning, and so is `first 2 min`. An end that is a time is part of the span: all of the microsecond it names.

    Raises:
        BadValue: if one is not written like a time, or the end lies before the start.
    """
    start_ns = parsed_ns("start", start, first_ns, last_ns) if start.strip() else 0
    if not end.strip():
        return Span(None, start_ns)
    end_ns = parsed_ns("end", end, first_ns, last_ns)
    if end_ns < start_ns:
        raise BadValue("end", f"{end!r} is before {start!r}.")
    return Span(None, start_ns, end_ns if is_relative(end) else last_ns_of(end, end_ns) + 1)


def parsed_ns(name: str, text: str, first_ns: int | None, last_ns: int) -> int:
    """One time as Unix time in nanoseconds, at most 64 bits; raises as `span_of`, also if it needs no `first_ns`."""
    relative = _RELATIVE.fullmatch(text.strip())
    found_ns = _relative_ns(name, relative, first_ns, last_ns) if relative else absolute_ns(name, text.strip())
    return min(max(found_ns, _EARLIEST), FOREVER)


def is_relative(text: str) -> bool:
    """Whether it counts from the beginning or the end of a recording."""
    return _RELATIVE.fullmatch(text.strip()) is not None


def last_ns_of(text: str, at_ns: int) -> int:
    """The last nanosecond of what a text names: of a time the whole microsecond, unless it is written more exactly."""
    if is_relative(text):
        return at_ns
    fraction = _FRACTION.search(text)
    return min(at_ns + 10 ** (9 - max(len(fraction[1]) if fraction else 0, 6)), FOREVER) - 1


def _relative_ns(name: str, relative: re.Match[str], first_ns: int | None, last_ns: int) -> int:
    words = {(relative[group] or "").lower() for group in ("before", "after")}
    unit = relative["unit"].lower()
    scale = _SECONDS["ms" if unit == "ms" or unit.startswith("milli") else unit[0]]
    away_ns = round(min(float(relative["number"]) * scale * 1e9, 2.0**64))
    if not words & {"first", "in"}:
        return last_ns - away_ns
    if words & {"last", "ago"}:
        raise BadValue(name, f"{relative[0]!r} counts from the beginning and from the end.", _HINT)
    if first_ns is None:
        unknown = f"{relative[0]!r} counts from a beginning that is not known."
        raise BadValue(name, unknown, 'Give a time, or "last 30 s".')
    return first_ns + away_ns


def absolute_ns(name: str, text: str, zone: timezone | None = None, hint: str = _HINT) -> int:
    """A time in ISO 8601 as Unix time in nanoseconds; of `zone` where it names none.

    Raises:
        BadValue: if it is no such time, or names no zone and none is assumed.
    """
    whole, fraction = text, ""
    if found := _FRACTION.search(text):
        whole, fraction = text[: found.start()] + text[found.end() :], found[1]
    try:
        date = datetime.fromisoformat(re.sub(r"[zZ]$", "+00:00", whole))
    except ValueError as error:
        raise BadValue(name, f"{text!r} is not a moment.", hint) from error
    if date.tzinfo is None and zone is None:
        raise BadValue(name, f"{text!r} has no time zone.", "Add Z for UTC, or an offset such as +01:00.")
    date = date if date.tzinfo else date.replace(tzinfo=zone)
    return round(date.timestamp()) * 1_000_000_000 + int(fraction.ljust(9, "0") or 0)
