"""A rate limit on messages: it decides for each message whether the message passes.

Server and bridge share it. Needs no ROS.
"""

from __future__ import annotations

MADE_UP_NS = 100_000_000


class Rhythm:
    """Lets messages pass at a rate, evenly: never faster, and not slower if enough messages come.

    Messages seldom come exactly when the next one is due. One that comes up to half a period early passes, and the next
    is due a period after this one *was due*: so the rate is exact on average, and all messages of a source with just
    that rate pass. Messages missed in a short stall of the source are made up for, at no more than twice the rate;
    those missed in a longer silence are not.
    """

    def __init__(self, rate_hz: float) -> None:
        self._period_ns = int(1e9 / rate_hz)
        self._due_ns = 0
        self._last_ns = 0

    def passes(self, now_ns: int) -> bool:
        """Return whether a message received at that time passes the rate limit. If the clock was set back, the rhythm
        restarts.
        """
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
