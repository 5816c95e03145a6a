"""Times in a recording as people and programs write them."""

from __future__ import annotations

import pytest

from ros2_mcp.model.errors import BadValue
from ros2_mcp.ops.sources.times import is_seconds_ago, last_ns_of, parsed_ns, span_of, taken_as

SECOND = 1_000_000_000
AT_NS = 1_767_225_600_000_000_000  # 2026-01-01T00:00:00Z


@pytest.mark.parametrize(
    ("text", "at_ns"),
    [
        ("2026-01-01T00:00:00", AT_NS),
        ("2026-01-01 00:00:00.25", AT_NS + 250_000_000),
        ("2026-01-01", AT_NS),
        ("2026-01-01T01:00:00+01:00", AT_NS),
        ("1767225600", AT_NS),
        (" 1767225600.5 ", AT_NS + 500_000_000),
        ("1767225600.123456789", AT_NS + 123_456_789),
        ("1.7672256e9", AT_NS),
        ("1767225600000", AT_NS),  # JavaScript's milliseconds
        ("1767225600000001", AT_NS + 1_000),  # microseconds
        ("1767225600000000001", AT_NS + 1),  # nanoseconds, as in metadata.yaml
        ("1.767225600000000001e18", AT_NS + 1),
        ("2026", AT_NS),
        ("20260101", AT_NS),
        ("30", 30_000_000_000),  # a recording of a simulation begins near 0
    ],
)
def test_a_time_without_a_zone_is_utc_and_a_unix_time_is_exact(text: str, at_ns: int) -> None:
    assert parsed_ns("start", text, 0, 100) == at_ns


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("2026-01-01T00:00:00", "2026-01-01T00:00:00 has no time zone and was read as UTC"),
        ("1767225600", "1767225600 is 2026-01-01T00:00:00.000000Z"),
        ("9" * 40, f"{'9' * 40} is 2262-04-11T23:47:16.854776Z"),
        ("2026-01-01T00:00:00Z", ""),
        ("last 30 s", ""),
        ("first 1 s", "first 1 s means the time that long after the beginning (0 s in)"),
        ("yesterday", ""),
        ("", ""),
    ],
)
def test_it_is_told_how_a_time_was_taken_that_does_not_say_it_all(text: str, said: str) -> None:
    assert taken_as(text) == said


def test_a_small_number_is_seconds_ago_and_a_large_one_a_unix_time() -> None:
    assert [is_seconds_ago(text) for text in ("0", "30", "12.5", "1767225600", "last 30 s", "")] == [True] * 3 + [
        False
    ] * 3


def test_nanoseconds_name_no_more_than_themselves() -> None:
    assert last_ns_of(str(AT_NS + 1), AT_NS + 1) == AT_NS + 1
    assert last_ns_of("1767225600", AT_NS) == AT_NS + 999


@pytest.mark.parametrize(
    ("start", "end", "named"), [("soon", "", "time_start"), ("", "soon", "time_end"), ("9", "8", "time_end")]
)
def test_an_error_names_the_argument_of_the_caller(start: str, end: str, named: str) -> None:
    with pytest.raises(BadValue, match=f"^{named}: "):
        span_of(start, end, 0, 10 * SECOND, ("time_start", "time_end"))


@pytest.mark.parametrize("text", ["9" * 5000, "1." + "9" * 5000, "٣٠"])
def test_a_number_that_is_no_time_is_refused_like_any_other_text(text: str) -> None:
    assert taken_as(text) == ""
    with pytest.raises(BadValue, match="is not a time"):
        parsed_ns("start", text, 0, 100)


@pytest.mark.parametrize(("start", "end"), [("3", ""), ("0", ""), ("", "2.5")])
def test_seconds_from_the_beginning_that_are_written_as_a_unix_time_are_refused(start: str, end: str) -> None:
    with pytest.raises(BadValue, match=f'write "{start or end} s in"'):
        span_of(start, end, AT_NS, AT_NS + 4 * SECOND)
    assert span_of("3", "", 0, 4 * SECOND).start_ns == 3 * SECOND  # a recording of simulated time


@pytest.mark.parametrize("text", ["2025-12-31T23:59:59Z", "2026-01-01T00:00:04.000001Z", "1767225605"])
def test_a_time_outside_the_recording_is_refused_where_it_acts(text: str) -> None:
    span_of(text, "", AT_NS, AT_NS + 4 * SECOND)
    for start, end in ((text, ""), ("", text)):
        with pytest.raises(BadValue, match="not in the recording"):
            span_of(start, end, AT_NS, AT_NS + 4 * SECOND, within=True)
    for start, end in (("2026-01-01", "2026-01-01T00:00:04Z"), ("last 30 s", "3 s in"), ("", "")):
        span_of(start, end, AT_NS + 999, AT_NS + 4 * SECOND + 999, within=True)


def test_seconds_in_as_an_end_include_what_is_written_with_them() -> None:
    assert span_of("", "2.5 s in", AT_NS, AT_NS + 4 * SECOND).end_ns == AT_NS + 2_501_000_000
