"""Which messages pass a rate limit. Shared by the bridge and the server; needs no ROS."""

from __future__ import annotations


class Rhythm:
    """Lets messages pass at no more than a rate, evenly, and never fewer than that where more come.

    Messages seldom come exactly when the next one is due. One that comes up to half a period early passes, and the
    next is due a period after this one *was due*: so the rate is exact on average, and a source that has just the
    rate asked for passes whole. What is missed in a silence is not made up for.
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
        if now_ns > self._due_ns + self._period_ns:
            self._due_ns = now_ns
        self._due_ns += self._period_ns
        self._last_ns = now_ns
        return True
