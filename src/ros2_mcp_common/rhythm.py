"""Which messages pass a rate limit. Shared by the bridge and the server; needs no ROS."""

from __future__ import annotations

MADE_UP_NS = 100_000_000


class Rhythm:
    """Lets messages pass at no more than a rate, evenly, and never fewer than that where more come.

    Messages seldom come exactly when the next one is due. One that comes up to half a period early passes, and the
    next is due a period after this one *was due*: so the rate is exact on average, and a source that has just the
    rate asked for passes whole. What is missed in a short stall of the source is made up for,
    no faster than at twice the rate; what is missed in a longer silence is not.
    """

    def __init__(self, rate_hz: float) -> None:
        self._period_ns = int(1e9 / rate_hz)
        self._due_ns = 0
        self._last_ns = 0

    def passes(self, now_ns: int) -> bool:
        """Whether a message of that time passes; a clock that is set back begins anew."""
        half_ns = self._period_ns // 2
        if now_ns < self._last_ns - self._period_ns:
            self._due_ns = self._last_ns = 0
        if now_ns < self._due_ns - half_ns or now_ns < self._last_ns + half_ns:
            return False
        if now_ns > self._due_ns + max(self._period_ns, MADE_UP_NS):
            self._due_ns = now_ns
        self._due_ns += self._period_ns
        self._last_ns = now_ns
        return True
