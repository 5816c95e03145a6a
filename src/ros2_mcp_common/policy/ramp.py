"""Limits on rates and on changes of commands: pure arithmetic, in which the current time is an argument."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from ros2_mcp_common.policy.fields import Numbers, names_at, put, reader

# The longest time that one step of a ramp counts. Otherwise the first command after a rest would be allowed a jump, as
# if it had had all that time. A smooth controller sends at least ten commands a second.
STEP_S = 0.1
# The burst that a bucket allows besides one message, in seconds of its rate: a sender that is late by this may catch
# up.
JITTER_S = 0.1
MINUTE_S = 60.0


class Bucket:
    """A rate limiter (token bucket): one message, and the burst of `JITTER_S`, may leave at once.

    `left_at` is when the last message before left (monotonic, s).
    """

    def __init__(self, rate_hz: float, left_at: float = -math.inf) -> None:
        self._rate_hz = rate_hz
        self._most = 1.0 + rate_hz * JITTER_S
        self._tokens = self._most if math.isinf(left_at) else 0.0
        self._at = 0.0 if math.isinf(left_at) else left_at

    def take(self, now: float) -> bool:
        """Return whether one more message may leave `now` (monotonic, s), and count it if so."""
        self._tokens = min(self._most, self._tokens + max(0.0, now - self._at) * self._rate_hz)
        self._at = now
        if self._tokens < 1.0:
            return False
        self._tokens -= 1.0
        return True


def allowed_part(sent: Sequence[float], wanted: Sequence[float], up: float, down: float, seconds: float) -> float:
    """Return the share, 0 to 1, of the step from the vector `sent` to `wanted` that a ramp allows within `seconds`.

    A vector that only grows may change by `up` per second, one that only shrinks by `down`, and any other, such as a
    reversal, by the smaller of both.
    """
    way = [new - old for old, new in zip(sent, wanted, strict=True)]
    length = math.hypot(*way)
    if not length:
        return 1.0
    if not math.isfinite(length):
        return 0.0
    if sum(old * step for old, step in zip(sent, way, strict=True)) >= 0.0:
        rate = up
    elif sum(new * step for new, step in zip(wanted, way, strict=True)) <= 0.0:
        rate = down
    else:
        rate = min(up, down)
    return 1.0 if math.isinf(rate) else min(1.0, rate * seconds / length)


class PerMinute:
    """A limit on uses within any minute; `left_at` are the earlier uses (monotonic, s), oldest first."""

    def __init__(self, left_at: Iterable[float] = ()) -> None:
        self._left_at: deque[float] = deque(left_at)

    def take(self, now: float, most: float) -> bool:
        """Return whether one more use is allowed `now` (monotonic, s) with at most `most` a
        minute, and count it if so.
        """
        while self._left_at and now - self._left_at[0] >= MINUTE_S:
            self._left_at.popleft()
        if len(self._left_at) + 1 > most:
            return False
        self._left_at.append(now)
        return True


class Ramp:
    """The ramps of one topic: for each path, how fast its vector may grow and shrink, the vector sent last, and when.

    If `zero_stops`, a command that is zero on all these paths is never held back, because it stops the robot.
    """

    def __init__(
        self, rates: Mapping[str, tuple[float, float]], rested_at: float = -math.inf, *, zero_stops: bool = True
    ) -> None:
        self._rates = rates
        self._zero_stops = zero_stops
        self._names: list[str] = []
        self._read: Numbers = reader(())
        self._parts: list[tuple[int, int, float, float]] = []
        self._sent: Sequence[float] = ()
        self._sent_at = rested_at

    def hold_back(self, message: Any, now: float) -> Mapping[str, float]:
        """Reduce the change of a message, in place, to what the ramps allow now.

        All paths take the same share of their step, so that the robot keeps the curvature of its path. Return the
        requested numbers by name; empty if nothing was changed.
        """
        if not self._parts:
            self._find(message)
        seconds = min(STEP_S, max(0.0, now - self._sent_at))
        wanted = self._read(message)
        if self._zero_stops and not any(wanted):
            return {}
        sent = self._sent or [0.0] * len(wanted)
        part = min(
            allowed_part(sent[first:last], wanted[first:last], up, down, seconds)
            for first, last, up, down in self._parts
        )
        if part >= 1.0:
            return {}
        allowed = [old + part * (new - old) if part else old for old, new in zip(sent, wanted, strict=True)]
        put(message, dict(zip(self._names, allowed, strict=True)))
        return dict(zip(self._names, wanted, strict=True))

    def has_left(self, message: Any, now: float) -> None:
        """Record that the message was sent with its current numbers."""
        self._sent, self._sent_at = self._read(message), now

    def rest(self, now: float) -> None:
        """Record that a zero was sent. Thread-safe."""
        self._sent, self._sent_at = (), now

    def _find(self, message: Any) -> None:
        """Find the numbers at the paths; raises as `names_at`."""
        for path, (up, down) in self._rates.items():
            first = len(self._names)
            self._names += names_at(message, path)
            self._parts.append((first, len(self._names), up, down))
        self._read = reader(self._names)
