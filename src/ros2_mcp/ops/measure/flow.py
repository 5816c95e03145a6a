"""Rate, gaps and silences of a topic, from the receive times of its messages alone.

Times are arrays of ascending Unix times in ns. `holes` are intervals in which a recording cannot be read: periods that
overlap one are ignored. NumPy is imported where it is used, so that listing the tools does not wait for it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Times: TypeAlias = "NDArray[np.int64]"

Holes: TypeAlias = "Sequence[tuple[int, int]]"

# A gap is a period longer than this many usual periods: more than jitter, so a message is missing.
GAP_FACTOR = 3.0
# The share of periods that are not longer than the usual one. The median would be too short if two publishers send in
# pairs, or four together: every pause between the pairs would be a gap.
_USUAL_SHARE = 0.8
# With fewer periods this share is meaningless, and the longest period is the usual one.
_LEAST_PERIODS = 4
# With fewer messages there are fewer than three periods, and none is usual.
_LEAST_MESSAGES = 4
# Fewer messages than this have no rate if they all arrived together: two messages 20 µs apart are no stream of 50 kHz.
# Together means within a tenth of the measured time if no period is usual, else within a hundredth, so that the rate of
# a sensor that stopped early is still reported.
_BURST_MESSAGES = 20
_FEW_SHARE, _BURST_SHARE = 0.1, 0.01


@dataclass(frozen=True, slots=True)
class Gap:
    """A time without messages, from the preceding message (or the start) on; `in_hole`: messages may be lost there."""

    from_ns: int
    duration_s: float
    in_hole: bool


@dataclass(frozen=True, slots=True)
class Silence:
    """A time without messages after some had been received, from a Unix time on; `is_end` if none followed."""

    from_ns: int
    duration_s: float
    is_end: bool


def over_holes(times_ns: Times, holes: Holes) -> NDArray[np.bool_]:
    """Return, for each period between two times, whether it overlaps a hole."""
    import numpy as np

    found = np.zeros(max(len(times_ns) - 1, 0), np.bool_)
    for start_ns, end_ns in holes:
        first = max(int(np.searchsorted(times_ns, start_ns, side="right")) - 1, 0)
        last = int(np.searchsorted(times_ns, max(end_ns, start_ns + 1), side="left"))
        found[first:last] = True
    return found


def periods_s(times_ns: Times, holes: Holes = ()) -> NDArray[Any]:
    """Return the periods between messages in s, without periods that overlap holes."""
    import numpy as np

    return np.diff(times_ns)[~over_holes(times_ns, holes)] / 1e9


def usual_s(periods: NDArray[Any]) -> float:
    """Return the usual period in s: four of five periods are not longer; with fewer than four periods, the longest."""
    import numpy as np

    share = _USUAL_SHARE if len(periods) >= _LEAST_PERIODS else 1.0
    return float(np.quantile(periods, share, method="lower"))


def rate_hz(times_ns: Times, holes: Holes = ()) -> float | None:
    """Return the rate in messages per second, without periods that overlap a hole of the recording; None if no two
    times differ.
    """
    import numpy as np

    periods_ns = np.diff(times_ns)[~over_holes(times_ns, holes)]
    span_s = int(periods_ns.sum()) / 1e9
    return len(periods_ns) / span_s if span_s > 0 else None


def is_burst(count: int, rate_hz: float | None, over_s: float) -> bool:
    """Return whether the messages arrived within so small a part of `over_s` seconds that they have no rate."""
    if rate_hz is None or count >= _BURST_MESSAGES:
        return False
    return (count - 1) / rate_hz < over_s * (_FEW_SHARE if count < _LEAST_MESSAGES else _BURST_SHARE)


def burst_in_words(count: int, rate_hz: float) -> str:
    """Return a sentence that there are too few messages to measure a rate."""
    return f"Only {count} messages came, within {1000 * (count - 1) / rate_hz:.3g} ms: too few to measure a rate."


def gaps(times_ns: Times, holes: Holes = (), edges_ns: tuple[int, ...] = ()) -> list[Gap]:
    """Return the periods longer than three usual periods; with both edges of the measured time in `edges_ns`, also the
    times before the first and after the last message.
    """
    import numpy as np

    found_s = periods_s(times_ns, holes)
    if len(times_ns) < _LEAST_MESSAGES or not len(found_s):
        return []
    limit_ns = GAP_FACTOR * usual_s(found_s) * 1e9
    bounded = np.sort(np.concatenate((times_ns, np.array(edges_ns, np.int64)))) if edges_ns else times_ns
    long, lost = np.diff(bounded), over_holes(bounded, holes)
    return [Gap(int(bounded[at]), int(long[at]) / 1e9, bool(lost[at])) for at in np.flatnonzero(long > limit_ns)]


def silence_in(times_ns: Times, end_ns: int, periods: float, least_s: float, holes: Holes = ()) -> Silence | None:
    """Return the silence at the end, else the longest silence, if it exceeds `periods` usual periods and `least_s`.

    None if there are fewer than four messages.
    """
    import numpy as np

    found_s = periods_s(times_ns, holes)
    if len(times_ns) < _LEAST_MESSAGES or not len(found_s):
        return None
    limit_s = max(periods * usual_s(found_s), least_s)
    bounded = np.append(times_ns, end_ns)
    silences = np.where(over_holes(bounded, holes), 0, np.diff(bounded))
    if (since_last_s := int(silences[-1]) / 1e9) > limit_s:
        return Silence(int(times_ns[-1]), since_last_s, is_end=True)
    longest = int(np.argmax(silences[:-1]))
    longest_s = int(silences[longest]) / 1e9
    return Silence(int(times_ns[longest]), longest_s, is_end=False) if longest_s > limit_s else None
