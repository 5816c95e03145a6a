"""What a latched topic replays to a new subscriber: of what was sent before, only the newest counts. Pure.

A publisher that is transient_local with a depth above 1 sends a new subscriber what it kept, the oldest first. Whoever
judges a state by its messages would judge what was true long ago.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Generic, Protocol, TypeVar

# What was kept comes in one go when a publisher is matched, through shared memory within ms; on a machine that is busy,
# or over a network, with pauses. Between two of it; the newest is given on after such a pause. Chosen, with room.
PAUSE_S = 0.25
# A publisher whose clock is behind seems to send old messages for ever: so long at most is waited for a newer one.
LONGEST_S = 1.0
# A subscription is matched with publishers that are known by then, on one host in 20 to 200 ms. Chosen, with room.
MATCHED_S = 0.5
# After so long without an old one, the next is of another publisher, which was discovered late: it replays as well.
QUIET_S = 1.0


class _Stamped(Protocol):
    @property
    def source_ns(self) -> int: ...


S = TypeVar("S", bound=_Stamped)


class NewestOfOld(Generic[S]):
    """Gives samples on, but of those that were sent before `opened_ns` (Unix time, by their publisher's clock) only the
    newest of each burst. `left_out` counts the others. `opened_at` and all `now` are monotonic, in s.
    """

    def __init__(self, opened_ns: int, opened_at: float) -> None:
        self._opened_ns, self._opened_at = opened_ns, opened_at
        self._has_come = False
        self._held: S | None = None
        self._first_at = self._last_at = float("-inf")
        self.left_out = 0

    def passed(self, sample: S, now: float) -> Sequence[S]:
        """What goes on now that this one has come: it alone, it after the one that was held back, or nothing."""
        self._has_come = True
        if not 0 < sample.source_ns < self._opened_ns:
            return [*self._release(), sample]
        was_quiet, self._last_at = now - self._last_at > QUIET_S, now
        if self._held is None and not was_quiet:  # no burst: a clock that is behind
            return [sample]
        if self._held is None:
            self._first_at, self._held = now, sample
        else:
            self.left_out += 1
            # Of several publishers the newest is the one that was sent last, not the one that came last.
            self._held = sample if sample.source_ns >= self._held.source_ns else self._held
        return []

    def due(self, now: float) -> Sequence[S]:
        """The one that was held back, once nothing more of the burst comes; to be asked again and again."""
        if self._held is None or (now - self._last_at < PAUSE_S and now - self._first_at < LONGEST_S):
            return ()
        return self._release()

    def is_settling(self, now: float) -> bool:
        """Whether what was sent before may still be about to come: then nobody should act without it."""
        return self._held is not None or (not self._has_come and now - self._opened_at < MATCHED_S)

    def _release(self) -> list[S]:
        held, self._held = self._held, None
        return [] if held is None else [held]
