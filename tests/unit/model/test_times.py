"""Tests of times as text."""

from ros2_mcp.model.times import recorded_time, seconds_from_start

BEGAN_NS = 1_800_000_000_000_000_000


def test_a_moment_of_a_recording_also_counts_from_its_beginning() -> None:
    assert recorded_time(BEGAN_NS + 12_300_456_789, BEGAN_NS) == "2027-01-15T08:00:12.300456Z (12.3 s in)"
    assert recorded_time(BEGAN_NS, BEGAN_NS) == "2027-01-15T08:00:00.000000Z (0 s in)"
    assert recorded_time(BEGAN_NS + 100_000_000_000, BEGAN_NS).endswith(" (100 s in)")


def test_a_moment_of_what_is_live_does_not() -> None:
    assert recorded_time(BEGAN_NS) == "2027-01-15T08:00:00.000000Z" and seconds_from_start(BEGAN_NS, None) is None


def test_seconds_after_the_beginning_are_rounded_down_so_that_the_message_is_after_them() -> None:
    assert seconds_from_start(BEGAN_NS + 12_345_999_999, BEGAN_NS) == 12.345


def test_a_recording_may_begin_at_0() -> None:
    assert seconds_from_start(10**9, 0) == 1.0
    assert recorded_time(10**9, 0) == "1970-01-01T00:00:01.000000Z (1 s in)"
