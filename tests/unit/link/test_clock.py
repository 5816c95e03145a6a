"""How far another machine's clock is, from answers that take their time, and after somebody has set a clock."""

from __future__ import annotations

import pytest

from ros2_mcp.link.clock import RobotClock

SECOND = 1_000_000_000
HOUR = 3600 * SECOND


class Machines:
    """This machine and the robot's, whose clock is `ahead_ns`; time passes only by `ping` and `passes`."""

    def __init__(self, ahead_ns: int = 0) -> None:
        self.now_ns = 1_800_000_000 * SECOND
        self.ahead_ns = ahead_ns
        self.set_ns = 0
        self.clock = RobotClock(lambda: self.now_ns + self.set_ns, lambda: self.now_ns / 1e9)

    def ping(self, there_ns: int, back_ns: int) -> None:
        sent_ns = self.clock.sending_ns()
        self.now_ns += there_ns
        robot_ns = self.now_ns + self.ahead_ns
        self.now_ns += back_ns
        self.clock.answered(sent_ns, robot_ns)

    def passes(self, seconds: float) -> None:
        self.now_ns += round(seconds * SECOND)

    @property
    def error_ns(self) -> int:
        """By how much our idea of the robot's time is wrong."""
        return abs(self.clock.now_ns() - (self.now_ns + self.ahead_ns))


MS = SECOND // 1000


def test_before_the_first_answer_the_robots_clock_is_taken_for_ours() -> None:
    machines = Machines()
    assert (machines.clock.is_known, machines.clock.offset_ns, machines.clock.rtt_s) == (False, 0, None)


@pytest.mark.parametrize("ahead_ns", [HOUR, -HOUR, 700 * MS, -700 * MS])
def test_the_offset_is_known_to_half_of_the_shortest_way(ahead_ns: int) -> None:
    machines = Machines(ahead_ns)
    machines.ping(20 * MS, 400 * MS)
    assert machines.error_ns <= 210 * MS
    machines.ping(25 * MS, 20 * MS)
    assert machines.error_ns <= 23 * MS
    machines.ping(500 * MS, 10 * MS)  # a longer way changes nothing
    assert machines.error_ns <= 23 * MS
    assert machines.clock.rtt_s == pytest.approx(0.045)


def test_clocks_that_cannot_be_told_apart_are_one() -> None:
    machines = Machines(4 * MS)
    machines.ping(3 * MS, 9 * MS)
    assert machines.clock.offset_ns == 0
    assert machines.clock.now_ns() == machines.now_ns


def test_a_way_that_was_shorter_counts_for_a_minute() -> None:
    machines = Machines()
    machines.ping(1 * MS, 1 * MS)
    machines.passes(59)
    machines.ping(50 * MS, 50 * MS)
    assert machines.clock.rtt_s == pytest.approx(0.002)
    machines.passes(2)
    machines.ping(60 * MS, 60 * MS)
    assert machines.clock.rtt_s == pytest.approx(0.1)


def test_a_robots_clock_that_is_set_is_noticed_by_the_next_answer() -> None:
    machines = Machines()
    machines.ping(5 * MS, 5 * MS)
    machines.ahead_ns = 10 * SECOND
    machines.ping(30 * MS, 30 * MS)
    assert machines.error_ns <= 30 * MS


def test_so_is_our_own_even_between_a_question_and_its_answer() -> None:
    machines = Machines(HOUR)
    machines.ping(5 * MS, 5 * MS)
    machines.set_ns = -60 * SECOND
    machines.ping(30 * MS, 30 * MS)
    assert machines.error_ns <= 30 * MS
    sent_ns = machines.clock.sending_ns()
    machines.set_ns = -120 * SECOND
    machines.clock.answered(sent_ns, machines.now_ns + HOUR)
    assert not machines.clock.is_known
    machines.ping(5 * MS, 5 * MS)
    assert machines.error_ns <= 5 * MS
