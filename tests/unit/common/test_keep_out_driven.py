"""Goals, paths and motions beside keep-out zones in simulated steps, under the judge and the watchdog of the bridge."""

from __future__ import annotations

import random
from collections import Counter

import pytest

from support.agent import FULL
from support.zone_drives import drive

ROUNDS = 100_000 if FULL else 150
pytestmark = pytest.mark.timeout(3600 if FULL else 120)


def test_no_goal_path_or_motion_brings_the_outline_into_a_zone() -> None:
    became: Counter[str] = Counter()
    for seed in range(ROUNDS):
        done = drive(random.Random(seed))
        assert not done.entries, f"drive {seed}: {done}"
        became.update(name for name in ("refused", "ended", "latched", "reached") if getattr(done, name))
    print(f"{ROUNDS} drives: {dict(became)}")
    assert became["refused"] > ROUNDS / 4 and became["ended"] > ROUNDS / 10 and became["reached"] > 0, became


def test_the_observer_sees_entries_where_nothing_judges() -> None:
    entries = sum(bool(drive(random.Random(seed), is_judged=False).entries) for seed in range(60))
    assert entries > 10


def test_a_corner_between_going_straight_on_and_turning_is_seen_in_time() -> None:
    done = drive(random.Random(59479))  # its outline came 1 cm into the zone when only the two extremes were judged
    assert done.ended and not done.entries and not done.latched
