"""The rate limit of relays: exact on average, even, and never below what it allows."""

from __future__ import annotations

import random

import pytest

from ros2_mcp_common.rhythm import Rhythm

SECOND = 1_000_000_000


def passed(rate_hz: float, times_s: list[float]) -> list[float]:
    rhythm = Rhythm(rate_hz)
    return [moment for moment in times_s if rhythm.passes(int(1e18 + moment * SECOND))]


@pytest.mark.parametrize("source_hz", [11, 13, 20, 30, 50, 100, 190, 200, 1000])
@pytest.mark.parametrize("target_hz", [1, 7.5, 10, 30, 150])
def test_the_rate_is_exact_where_more_comes_and_all_passes_where_less_does(source_hz, target_hz) -> None:
    chance = random.Random(1)
    times = [(number + chance.uniform(-0.1, 0.1)) / source_hz for number in range(source_hz * 60)]
    expected = min(source_hz, target_hz) * 60
    assert len(passed(target_hz, times)) == pytest.approx(expected, rel=0.01, abs=1)


def test_a_source_of_just_the_rate_passes_whole() -> None:
    chance = random.Random(2)
    times = [number / 10 + chance.uniform(-0.02, 0.02) for number in range(1000)]
    assert passed(10.0, times) == times


def test_what_a_short_stall_of_the_source_missed_is_made_up_for() -> None:
    times = [number / 200 for number in range(4000) if number % 40 >= 8]  # 40 ms of silence, five times a second
    assert len(passed(140.0, times)) == pytest.approx(2800, rel=0.01)


def test_a_silence_is_not_made_up_for() -> None:
    burst = [100 + number / 1000 for number in range(1000)]
    assert len(passed(10.0, [0.0, *burst])) <= 13


def test_a_clock_that_is_set_back_stops_nothing() -> None:
    rhythm = Rhythm(10.0)
    assert rhythm.passes(2_000 * SECOND)
    assert rhythm.passes(1_000 * SECOND)
    assert not rhythm.passes(1_000 * SECOND + 1)
    assert rhythm.passes(1_001 * SECOND)
