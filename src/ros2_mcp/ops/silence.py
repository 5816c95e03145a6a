"""Where a stream of messages fell silent."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import median

_LEAST_MESSAGES = 4


@dataclass(frozen=True, slots=True)
class Silence:
    """A time without messages after some had come, from a Unix time on; `is_end` if none came after it."""

    from_ns: int
    duration_s: float
    is_end: bool


def silence_in(received_ns: Sequence[int], end_ns: int, periods: float, least_s: float) -> Silence | None:
    """The silence at the end, else the longest one, if it is longer than so many median periods and `least_s`.

    None where there are fewer than four messages, which do not tell what is usual.
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
