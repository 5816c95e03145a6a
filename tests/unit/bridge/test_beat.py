"""When a topic is late: within 0.1 s after its period, and never while it only comes unevenly."""

import random

import pytest

from ros2_mcp_bridge.motion.drive import Beat


@pytest.mark.parametrize("jitter_s", [0.0, 0.005, 0.01, 0.015, 0.02])
def test_a_scan_of_10_hz_that_jitters_is_never_late_and_its_silence_is_told_20_ms_before_it_must_be(jitter_s):
    chance = random.Random(7)
    beat, at = Beat("/scan"), 0.0
    latest = 0.0
    for number in range(20_000):
        at = number * 0.1 + chance.uniform(-jitter_s, jitter_s)
        if number > 8:
            assert beat.late_s(at) < 0, "late, though it came"
        beat.heard(at)
        if number > 8:
            latest = max(latest, -beat.late_s(at))
    assert 0.15 <= latest <= 0.2 - 0.02


def test_a_topic_that_comes_in_bursts_is_not_late_between_them():
    beat, at = Beat("/scan"), 0.0
    for number in range(100):
        at += 0.35 if number % 2 else 0.05
        assert number < 9 or beat.late_s(at) < 0
        beat.heard(at)
