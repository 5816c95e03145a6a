"""The newest of the messages that a latched topic replays to a new subscriber; older messages are dropped. Needs no
ROS.

A transient_local publisher with a depth above 1 sends a new subscriber the messages that it kept, oldest first. A
condition evaluated on them would be true of the past.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Generic, Protocol, TypeVar

# The longest pause between two kept messages; after such a pause, the newest is passed on. They come in one burst when
# a publisher is matched: within milliseconds through shared memory, with pauses on a busy machine or over a network.
PAUSE_S = 0.25
# The longest wait for a newer message: a publisher whose clock is behind seems to send old messages for ever.
LONGEST_S = 1.0
# The time within which a subscription matches the publishers known by then: 20 to 200 ms on one host, with a margin.
MATCHED_S = 0.5
# After this time without an old message, the next is from another publisher, discovered late, which replays as well.
QUIET_S = 1.0


class _Stamped(Protocol):
    @property
    def source_ns(self) -> int: ...


S = TypeVar("S", bound=_Stamped)


class NewestOfOld(Generic[S]):
    """Passes samples on, but of samples sent before `opened_ns` (Unix time by the publisher's clock) only the newest of
    a burst.

    `left_out` counts the others. `opened_at` and all `now` are monotonic, in s.
    """

    def __init__(self, opened_ns: int, opened_at: float) -> None:
        self._opened_ns, self._opened_at = opened_ns, opened_at
        self._has_come = False
        self._held: S | None = None
        self._first_at = self._last_at = float("-inf")
        self.left_out = 0

    def passed(self, sample: S, now: float) -> Sequence[S]:
        """Return the samples to pass on after this sample was received: this sample alone, the held-back sample and
        this sample, or none.
        """
        self._has_come = True
        if not 0 < sample.source_ns < self._opened_ns:
            return [*self._release(), sample]
        was_quiet, self._last_at = now - self._last_at > QUIET_S, now
        if self._held is None and not was_quiet:  # no burst: the publisher's clock is behind
            return [sample]
        if self._held is None:
            self._first_at, self._held = now, sample
        else:
            self.left_out += 1
            # With several publishers, the newest sample is the one sent last, not the one received last.
            self._held = sample if sample.source_ns >= self._held.source_ns else self._held
        return []

    def due(self, now: float) -> Sequence[S]:
        """Return the sample held back, once the burst is over. To be called again and again."""
        if self._held is None or (now - self._last_at < PAUSE_S and now - self._first_at < LONGEST_S):
            return ()
        return self._release()

    def is_settling(self, now: float) -> bool:
        """Return whether older messages may still be about to come, without which a caller should not act."""
        return self._held is not None or (not self._has_come and now - self._opened_at < MATCHED_S)

    def _release(self) -> list[S]:
        held, self._held = self._held, None
        return [] if held is None else [held]
