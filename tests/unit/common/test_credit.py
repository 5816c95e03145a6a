"""How much is under way follows what the link carries: stepped against a link of which only the arithmetic is there."""

from __future__ import annotations

import heapq
from dataclasses import dataclass, field

import pytest

from ros2_mcp_common.wire.limits import MOST_WINDOW_BYTES, PIECE_BYTES, WINDOW_BYTES
from ros2_mcp_common.wire.pieces import RATE_KEPT_S, Credit

MBIT = 1e6 / 8


@dataclass
class Link:
    """A sender that always has something to send, and a link with a queue; times in s, sizes in bytes."""

    bytes_per_s: float
    rtt_s: float
    now: float = 0.0
    free_at: float = 0.0
    taken: int = 0
    waited: list[float] = field(default_factory=list[float])
    """How long a small packet would have waited in the link behind what was ahead of it, at each piece."""
    acks: list[tuple[float, int]] = field(default_factory=list[tuple[float, int]])

    def __post_init__(self) -> None:
        self.credit = Credit(WINDOW_BYTES, lambda: self.now)
        self.written = 0

    def run(self, seconds: float) -> float:
        """Goes on for so long; returns what arrived, in bytes per s."""
        end, before = self.now + seconds, self.taken
        self.waited.clear()
        while self.now < end:
            while self.credit.has_room:
                size = self.credit.piece_bytes
                self.credit.write(size)
                self.written += size
                self.free_at = max(self.free_at, self.now) + size / self.bytes_per_s
                self.waited.append(self.free_at - self.now)
                heapq.heappush(self.acks, (self.free_at + self.rtt_s, self.written))
            self.now, self.taken = heapq.heappop(self.acks)
            self.credit.acknowledge(self.taken)
        return (self.taken - before) / seconds


@pytest.mark.parametrize(
    ("mbit", "rtt_s"),
    [
        (0.064, 0.02),
        (0.064, 0.6),
        (0.5, 0.3),
        (5, 0.042),
        (5, 0.5),
        (20, 0.02),
        (50, 0.1),
        (50, 0.2),
        (150, 0.03),
        (1000, 0.001),
    ],
)
def test_a_link_is_used_whole_and_little_waits_in_it(mbit: float, rtt_s: float) -> None:
    link = Link(mbit * MBIT, rtt_s)
    link.run(10.0)
    carried = link.run(10.0)
    print(
        f"{mbit} Mbit/s, {rtt_s} s: {carried / MBIT:.1f} Mbit/s, waits {max(link.waited):.3f} s",
        link.credit.window_bytes,
    )
    assert carried >= 0.95 * mbit * MBIT
    # A third of a round trip, or the window that there always was.
    assert max(link.waited) <= max(rtt_s / 3, WINDOW_BYTES / link.bytes_per_s) + 3 * PIECE_BYTES / link.bytes_per_s


def test_over_a_slow_link_the_window_stays_as_it_was_measured_to_be_best() -> None:
    link = Link(5 * MBIT, 0.042)
    link.run(10.0)
    assert link.credit.window_bytes <= 1.3 * WINDOW_BYTES


def test_a_link_that_becomes_slow_is_noticed() -> None:
    link = Link(50 * MBIT, 0.1)
    link.run(10.0)
    assert link.credit.window_bytes > 500_000
    link.bytes_per_s = 2 * MBIT
    link.run(RATE_KEPT_S + 5)
    link.run(5.0)
    assert max(link.waited) <= 0.5


def test_what_is_under_way_is_bounded_however_fast_and_far_a_link_is() -> None:
    link = Link(10_000 * MBIT, 0.2)
    link.run(5.0)
    assert link.credit.window_bytes == MOST_WINDOW_BYTES
