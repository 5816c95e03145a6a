"""Of what a latched topic replays only the newest counts."""

from __future__ import annotations

from typing import NamedTuple

from ros2_mcp_bridge.topics.replayed import LONGEST_S, MATCHED_S, PAUSE_S, NewestOfOld

OPENED_NS = 1_000_000


class One(NamedTuple):
    source_ns: int


def test_of_a_burst_of_old_ones_only_the_newest_goes_on_after_a_pause() -> None:
    newest = NewestOfOld[One](OPENED_NS, 0.0)
    assert not [one for at in range(10) for one in newest.passed(One(at + 1), at / 1000)]
    assert not newest.due(0.01)
    assert newest.due(0.01 + PAUSE_S) == [One(10)]
    assert not newest.due(1.0) and newest.left_out == 9


def test_a_new_one_goes_on_at_once_after_the_newest_old_one() -> None:
    newest = NewestOfOld[One](OPENED_NS, 0.0)
    newest.passed(One(1), 0.0)
    newest.passed(One(2), 0.0)
    assert newest.passed(One(OPENED_NS), 0.001) == [One(2), One(OPENED_NS)]
    assert newest.passed(One(OPENED_NS + 1), 0.002) == [One(OPENED_NS + 1)]


def test_without_the_publishers_time_all_go_on() -> None:
    assert NewestOfOld[One](OPENED_NS, 0.0).passed(One(0), 0.0) == [One(0)]


def test_of_two_publishers_the_one_that_was_sent_last_is_the_newest() -> None:
    newest = NewestOfOld[One](OPENED_NS, 0.0)
    for source_ns in (5, 9, 2, 3):
        newest.passed(One(source_ns), 0.0)
    assert newest.due(PAUSE_S) == [One(9)]


def test_a_publisher_whose_clock_is_behind_is_heard_after_a_second_and_then_at_once() -> None:
    newest = NewestOfOld[One](OPENED_NS, 0.0)
    passed: list[One] = []
    for number in range(100):
        at = number * 0.05
        passed += [*newest.passed(One(number + 1), at), *newest.due(at)]
    assert len(passed) == 100 - round(LONGEST_S / 0.05)
    assert passed[-1] == One(100)


def test_one_that_is_discovered_late_replays_too() -> None:
    newest = NewestOfOld[One](OPENED_NS, 0.0)
    newest.passed(One(1), 0.0)
    assert newest.due(PAUSE_S) == [One(1)]
    assert not newest.passed(One(2), 3.0) and not newest.passed(One(3), 3.0)
    assert newest.due(3.0 + PAUSE_S) == [One(3)]


def test_it_settles_once_what_was_sent_before_has_come_or_does_not_come() -> None:
    newest = NewestOfOld[One](OPENED_NS, 0.0)
    assert newest.is_settling(0.1) and not newest.is_settling(MATCHED_S)
    newest.passed(One(1), 0.2)
    assert newest.is_settling(0.3)
    newest.due(0.2 + PAUSE_S)
    assert not newest.is_settling(0.2 + PAUSE_S)
