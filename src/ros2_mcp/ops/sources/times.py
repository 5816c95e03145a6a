"""Parse times in a recording as people and programs write them: ISO 8601, UNIX time, or relative to the recording."""

from __future__ import annotations

import re
from contextlib import suppress
from datetime import datetime, timezone

from ros2_mcp.bags.stored import FOREVER, Span
from ros2_mcp.model.errors import BadValue
from ros2_mcp.model.times import iso_time, recorded_time

_RELATIVE = re.compile(
    r"(?P<before>first|last)?\s*(?P<number>[0-9]+(?:\.[0-9]+)?)\s*"
    r"(?P<unit>ms|milliseconds?|s|sec|seconds?|min|minutes?|h|hours?)(?:\s+(?P<after>ago|in))?",
    re.IGNORECASE,
)
_SECONDS = {"ms": 0.001, "mi": 60.0, "m": 60.0, "s": 1.0, "h": 3600.0}
_FRACTION = re.compile(r"[.,]([0-9]{1,9})[0-9]*")
_UNIX = re.compile(
    r"(?P<whole>[0-9]{1,40})(?:\.(?P<fraction>[0-9]{1,40}))?(?:e\+?(?P<exponent>[0-9]{1,2}))?", re.IGNORECASE
)
"""The length is bounded because Python refuses to read a number of more than 4300 digits."""
_YEAR = re.compile(r"((?:19|20)[0-9]{2})(?:(0[1-9]|1[0-2])(0[1-9]|[12][0-9]|3[01]))?")
"""A year, or a date in ISO's basic form: as a UNIX time it would be one of 1970."""
_UNITS_NS = ((10**11, 10**9), (10**14, 10**6), (10**17, 1000))
"""Below 10^11 a UNIX time is in seconds (until the year 5138), then in milliseconds, then in microseconds, and from
10^17 on in nanoseconds, as stamps of bags and of Python programs are."""
_NS_DIGITS = 17
_NOT_AGO_S = 1e9
"""A number of seconds ago from this size on (32 years) is a UNIX time: that of 2001 or later."""
_MILLISECOND_NS = 1_000_000
"""Times in a recording are written in whole milliseconds after its beginning."""
_EARLIEST = -(2**63)
_HINT = 'Write it like 2026-11-21T03:00:00Z, 2026-11-21T03:00:00.5+01:00, 1795230000.5, "last 30 s" or "2 min in".'


def span_of(
    start: str,
    end: str,
    first_ns: int,
    last_ns: int,
    names: tuple[str, str] = ("start", "end"),
    *,
    within: bool = False,
) -> Span:
    """Return the span between two times of a recording from `first_ns` to `last_ns`; an
    empty time is its beginning or end.

    `last 30 s` and `30 s ago` count back from the recording's end; `2 min in` is the time two minutes after its
    beginning, and so is `first 2 min`. An end that names a moment is part of the span: the whole microsecond of an
    absolute time, the whole millisecond of `2.5 s in`. `names` are the caller's arguments for both. With `within`, a
    time outside the recording is an error; without it, only a number too small for a UNIX time is.

    Raises:
        BadValue: if a time is malformed or not in the recording, or the end lies before the start.
    """
    times_ns: list[int] = []
    for name, text in zip(names, (start, end), strict=True):
        at_ns = parsed_ns(name, text, first_ns, last_ns) if text.strip() else 0
        times_ns.append(at_ns)
        if not text.strip() or is_relative(text) or not (within or _is_small(text)):
            continue
        if at_ns > last_ns or last_ns_of(text, at_ns) < first_ns:
            raise _outside(name, text.strip(), at_ns, (first_ns, last_ns))
    start_ns, end_ns = times_ns
    if not end.strip():
        return Span(None, start_ns)
    if end_ns < start_ns:
        raise BadValue(names[1], f"{end!r} is before {start!r}.")
    until_ns = last_ns_of(end, end_ns)
    return Span(None, start_ns, end_ns if until_ns == end_ns and is_relative(end) else until_ns + 1)


def _outside(name: str, text: str, at_ns: int, covers: tuple[int, int]) -> BadValue:
    """Return the error for a time outside the recording, with a suggestion."""
    first_ns, last_ns = covers
    meant = f'To count from its beginning, write "{text} s in". ' if _UNIX.fullmatch(text) else ""
    until = recorded_time(last_ns, first_ns)
    return BadValue(
        name,
        f"{text} is {iso_time(at_ns)}, which is not in the recording.",
        f"{meant}The recording covers {iso_time(first_ns)} to {until}.",
    )


def parsed_ns(name: str, text: str, first_ns: int | None, last_ns: int) -> int:
    """Return one time as Unix time in nanoseconds, at most 64 bits. Raises the same errors as `span_of`, also if a
    relative time needs an unknown `first_ns`.
    """
    relative = _RELATIVE.fullmatch(text.strip())
    found_ns = _relative_ns(name, relative, first_ns, last_ns) if relative else absolute_ns(name, text.strip())
    return min(max(found_ns, _EARLIEST), FOREVER)


def is_relative(text: str) -> bool:
    """Return whether a time counts from the beginning or the end of a recording."""
    return _RELATIVE.fullmatch(text.strip()) is not None


def is_seconds_ago(text: str) -> bool:
    """Return whether a text is a number so small that it can only mean seconds ago, not a UNIX time."""
    return _UNIX.fullmatch(text.strip()) is not None and float(text) < _NOT_AGO_S


def _is_small(text: str) -> bool:
    """Return whether a text is a number too small for a UNIX time, except one of a recording of simulated time."""
    return is_seconds_ago(text) and not _YEAR.fullmatch(text.strip())


def last_ns_of(text: str, at_ns: int) -> int:
    """Return the last nanosecond that a text names: for a time the end of its microsecond,
    unless it is written more exactly.

    For `12.3 s in` it is the end of the millisecond, the unit of such times; other relative times name a single
    nanosecond.
    """
    if relative := _RELATIVE.fullmatch(text.strip()):
        return min(at_ns + _MILLISECOND_NS, FOREVER) - 1 if (relative["after"] or "").lower() == "in" else at_ns
    unix = _UNIX.fullmatch(text.strip())
    if unix and len(unix["whole"]) > _NS_DIGITS:
        return at_ns
    fraction = _FRACTION.search(text)
    return min(at_ns + 10 ** (9 - max(len(fraction[1]) if fraction else 0, 6)), FOREVER) - 1


def taken_as(text: str) -> str:
    """Return how an incomplete time was interpreted: without a zone, a UNIX time, `first 1 s`; else empty."""
    text = text.strip()
    relative = _RELATIVE.fullmatch(text)
    if relative and (relative["before"] or "").lower() == "first":
        return f"{text} means the time that long after the beginning (0 s in)"
    if _UNIX.fullmatch(text) or _YEAR.fullmatch(text):
        return f"{text} is {iso_time(min(absolute_ns('', text), FOREVER))}"
    with suppress(ValueError):
        if _date(text, _FRACTION.search(text)).tzinfo is None:
            return f"{text} has no time zone and was read as UTC"
    return ""


def _relative_ns(name: str, relative: re.Match[str], first_ns: int | None, last_ns: int) -> int:
    words = {(relative[group] or "").lower() for group in ("before", "after")}
    unit = relative["unit"].lower()
    scale = _SECONDS["ms" if unit == "ms" or unit.startswith("milli") else unit[0]]
    away_ns = round(min(float(relative["number"]) * scale * 1e9, 2.0**64))
    if not words & {"first", "in"}:
        return last_ns - away_ns
    if words & {"last", "ago"}:
        raise BadValue(name, f"{relative[0]!r} counts from both the beginning and the end.", _HINT)
    if first_ns is None:
        unknown = f"{relative[0]!r} counts from the beginning, which is not known here."
        raise BadValue(name, unknown, 'Give a time, or "last 30 s".')
    return first_ns + away_ns


def absolute_ns(name: str, text: str, hint: str = _HINT) -> int:
    """Return the Unix time in nanoseconds of a time in ISO 8601 (UTC if it names no zone) or a UNIX time.

    Raises:
        BadValue: if the text is not such a time.
    """
    if year := _YEAR.fullmatch(text):
        text = "-".join(part or "01" for part in (year[1], year[2], year[3]))
    elif unix := _UNIX.fullmatch(text):
        return _unix_ns(unix)
    fraction = _FRACTION.search(text)
    try:
        date = _date(text, fraction)
    except ValueError as error:
        raise BadValue(name, f"{text!r} is not a time.", hint) from error
    date = date if date.tzinfo else date.replace(tzinfo=timezone.utc)
    return round(date.timestamp()) * 1_000_000_000 + int((fraction[1] if fraction else "").ljust(9, "0"))


def _date(text: str, fraction: re.Match[str] | None) -> datetime:
    """Return a time in ISO 8601 without its fraction of a second. Raises `ValueError`."""
    whole = text[: fraction.start()] + text[fraction.end() :] if fraction else text
    return datetime.fromisoformat(re.sub(r"[zZ]$", "+00:00", whole))


def _unix_ns(unix: re.Match[str]) -> int:
    """Return a UNIX time in nanoseconds; its size gives its unit. The result is exact, which a float would not be."""
    fraction = unix["fraction"] or ""
    digits, shift = int(unix["whole"] + fraction), int(unix["exponent"] or 0) - len(fraction)
    size = digits * 10**shift if shift >= 0 else digits // 10**-shift
    unit_ns = next((unit for below, unit in _UNITS_NS if size < below), 1)
    return digits * unit_ns * 10**shift if shift >= 0 else digits * unit_ns // 10**-shift
