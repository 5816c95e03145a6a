"""How messages flow, from the times of their receipt alone: rate, gaps, and where a stream fell silent."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import median

# A gap is a period longer than this many times the median one: a message that is missing, and more than jitter.
GAP_FACTOR = 3.0
# With fewer messages, and so fewer than three periods, no period can be called usual.
_LEAST_MESSAGES = 4


@dataclass(frozen=True, slots=True)
class Gap:
    """A time without messages: from the message before it (or the beginning), `duration_s` long."""

    at_s: float
    duration_s: float


@dataclass(frozen=True, slots=True)
class Silence:
    """A time without messages after some had come, from a Unix time on; `is_end` if none came after it."""

    from_ns: int
    duration_s: float
    is_end: bool


def rate_hz(times_s: Sequence[float]) -> float | None:
    """Messages per second between the first and the last; None where there are not two different times."""
    span_s = float(times_s[-1] - times_s[0]) if len(times_s) > 1 else 0.0
    return (len(times_s) - 1) / span_s if span_s > 0 else None


def gaps(times_s: Sequence[float], *edges_s: float) -> list[Gap]:
    """Periods longer than three times the median one; with both edges of a time also before the first and after the
    last message.
    """
    if len(times_s) < _LEAST_MESSAGES:
        return []
    limit_s = GAP_FACTOR * median(later - earlier for earlier, later in pairwise(times_s))
    bounded = sorted([*times_s, *edges_s]) if edges_s else times_s
    return [Gap(earlier, later - earlier) for earlier, later in pairwise(bounded) if later - earlier > limit_s]


def silence_in(received_ns: Sequence[int], end_ns: int, periods: float, least_s: float) -> Silence | None:
    """The silence at the end, else the longest one, if it is longer than `periods` median periods and than `least_s`.

    None where there are fewer than four messages.
    """
    if len(received_ns) < _LEAST_MESSAGES:
        return None
    silences = [((later - earlier) / 1e9, earlier) for earlier, later in pairwise(received_ns)]
    limit_s = max(periods * median(duration_s for duration_s, _ in silences), least_s)
    since_last_s = (end_ns - received_ns[-1]) / 1e9
    if since_last_s > limit_s:
        return Silence(received_ns[-1], since_last_s, is_end=True)
    longest_s, from_ns = max(silences)
    return Silence(from_ns, longest_s, is_end=False) if longest_s > limit_s else None
