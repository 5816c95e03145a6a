"""Numerical functions of measurements: pure functions on NumPy arrays. Times are in seconds, ascending.

Import it inside functions only: NumPy takes time to load, and listing the tools must not wait for it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from ros2_mcp.values.select import FieldPath

Numbers: TypeAlias = "NDArray[np.float64]"

# A jump is a step larger than this many usual steps (a robust standard deviation).
JUMP_FACTOR = 8.0
# A value is stuck if it stays the same for this many samples and this share of all, although it usually changes.
STUCK_SAMPLES = 5
STUCK_SHARE = 0.1
# With fewer steps there is no usual one.
_LEAST_STEPS = 3
# For a value that is mostly constant, up to one step in a hundred is a jump; more are normal.
_RARE_STEPS = 100
# Least share of changes, among the messages outside long rests, of a value that usually changes.
_LIVELY = 0.8
# Share of steps in the opposite direction above which a value is noisy: two of three in pure noise, few in a smooth
# signal.
_NOISY = 0.25
# Factor from the median absolute deviation to the standard deviation of a normal distribution: 1 / Φ⁻¹(3/4).
_MAD_TO_SIGMA = 1.4826
# With fewer points some delay always fits well.
_LEAST_POINTS = 8
# The most points on which two signals are correlated: measured 0.12 s for one field.
_GRID = 2000
# A peak of at least this share of the best correlation fits as well: a periodic signal has one for each period.
_NEAR_BEST = 0.98
# For values scaled to 1, a mean square below this is rounding: doubles are exact to about 1e-16.
_ROUNDING = 1e-28
# The number of parts over which a trend must keep its direction; in noise 1 of 5,000 signals does so by chance.
_BLOCKS = 8
# Least slope of a trend in standard errors: noise that keeps its direction by chance never reaches it.
_SURE_SLOPE = 8.0
# Changes smaller than this share of the largest value are rounding errors: some units in the last place of float32, in
# which many values sent as float64 were computed. Integers are exact.
_ROUNDING_OF = {"float32": 1e-6, "float64": 1e-7}


@dataclass(frozen=True, slots=True)
class Jump:
    """A step much larger than usual, from the value at `since_s` to the next value at `at_s`."""

    since_s: float
    at_s: float
    before: float
    after: float


@dataclass(frozen=True, slots=True)
class Stuck:
    """A value that stayed the same for `samples` messages although it usually changes."""

    at_s: float
    duration_s: float
    samples: int
    value: float


def number(value: Any) -> float | None:
    """Return a finite number as a float; None for NaN and infinities, which JSON lacks."""
    return float(value) if math.isfinite(value) else None


def rounding(path: FieldPath) -> float:
    """Return the share of a field's largest value below which its changes may be rounding errors."""
    return _ROUNDING_OF.get(path.steps[-1].field.type.base, 0.0)


def jumps(times: Numbers, values: Numbers, rounded: float = 0.0) -> list[Jump]:
    """Return steps much larger than usual, and larger than the share `rounded` of the largest value.

    A value that is mostly constant has jumps only if it changes rarely.
    """
    steps = np.diff(values)
    if len(steps) < _LEAST_STEPS:
        return []
    size = np.abs(steps)
    if (median := float(np.median(size))) > 0:
        usual = max(_MAD_TO_SIGMA * float(np.median(np.abs(steps - np.median(steps)))), median)
        large = size > max(JUMP_FACTOR * usual, rounded * float(np.abs(values).max()))
    else:
        large = size > 0
        if np.count_nonzero(large) > max(1, len(steps) // _RARE_STEPS):
            return []
    return [
        Jump(float(times[i]), float(times[i + 1]), float(values[i]), float(values[i + 1]))
        for i in np.flatnonzero(large)
    ]


def stuck(times: Numbers, values: Numbers) -> Stuck | None:
    """Return the longest time that a value which usually changes stayed the same, if that is suspicious; else None.

    It is suspicious if the value is otherwise noisy, or jumps when it changes again. A smooth value may just rest, as a
    robot does.
    """
    starts = np.flatnonzero(np.concatenate(([True], np.diff(values) != 0)))
    if len(starts) <= STUCK_SAMPLES:
        return None
    lengths = np.diff(np.append(starts, len(values)))
    longest = int(np.argmax(lengths))
    first, samples = int(starts[longest]), int(lengths[longest])
    is_rest = lengths >= max(STUCK_SAMPLES, STUCK_SHARE * len(values))
    moving = len(values) - int(lengths[is_rest].sum())
    is_lively = np.count_nonzero(~is_rest) >= max(_LIVELY * moving, STUCK_SAMPLES)
    steps = np.diff(values[starts])
    is_noisy = np.count_nonzero(np.diff(np.sign(steps))) / max(len(steps) - 1, 1) > _NOISY
    leaps = longest < len(steps) and abs(steps[longest]) > JUMP_FACTOR * float(np.median(np.abs(steps)))
    if not (is_rest[longest] and is_lively and (is_noisy or leaps)):
        return None
    last = first + samples - 1
    return Stuck(float(times[first]), float(times[last] - times[first]), samples, float(values[first]))


def trend(times: Numbers, values: Numbers, rounded: float = 0.0) -> float | None:
    """Return the slope per second of a value that keeps its direction the whole time, apart from noise; else None.

    The means of eight parts must follow each other in one direction, with at most one step without change, and change
    by more than the share `rounded` of the largest value.
    """
    if len(values) < 2 * _BLOCKS:
        return None
    means = np.array([part.mean() for part in np.array_split(values, _BLOCKS)])
    change, steps = float(means[-1] - means[0]), np.diff(means)
    onwards = np.sign(steps) * np.sign(change)
    if onwards.min() < 0 or np.count_nonzero(onwards) < len(steps) - 1:
        return None
    if not math.isfinite(change) or abs(change) <= rounded * float(np.abs(values).max()):
        return None
    alike = correlation(times, values)
    if alike is None or alike**2 * (len(values) - 2) < _SURE_SLOPE**2 * (1 - alike**2):
        return None
    away: Numbers = times - times.mean()
    return float(away @ values) / float(away @ away)


def pairs(first: Numbers, second: Numbers) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the indices of paired times: each is the nearest time to the other, within a limit.

    The limit is half of the longer of the two median periods; there is none if one side has fewer than two times.
    """
    if not len(first) or not len(second):
        return np.zeros(0, np.intp), np.zeros(0, np.intp)
    forth, back = _nearest(first, second), _nearest(second, first)
    periods = [_period(times) for times in (first, second) if len(times) > 1]
    limit = max(periods) / 2 if len(periods) == 2 else math.inf
    mutual = np.flatnonzero(back[forth] == np.arange(len(first)))
    near = mutual[np.abs(first[mutual] - second[forth[mutual]]) <= limit]
    return near, forth[near]


def _nearest(times: Numbers, others: Numbers) -> NDArray[np.intp]:
    """Return for each time the index of the nearest of the others."""
    if len(others) == 1:
        return np.zeros(len(times), np.intp)
    right = np.minimum(np.maximum(np.searchsorted(others, times), 1), len(others) - 1)
    return np.where(times - others[right - 1] <= others[right] - times, right - 1, right)


def _period(times: Numbers) -> float:
    return float(np.median(np.diff(times)))


def correlation(first: Numbers, second: Numbers) -> float | None:
    """Return Pearson's correlation; None if one of the two does not vary."""
    if len(first) < 2:
        return None
    # scaled by the largest magnitude, so that no square overflows
    one, other = (values / (max(float(values.max()), -float(values.min())) or 1.0) for values in (first, second))
    one -= one.mean()
    other -= other.mean()
    norm = math.sqrt(float(one @ one) * float(other @ other))
    return number(one @ other / norm) if norm > _ROUNDING * len(first) else None


def delay(
    first_times: Numbers, first: Numbers, second_times: Numbers, second: Numbers
) -> tuple[float | None, float | None]:
    """Return the delay of the second signal behind the first in s, and their correlation at that delay (-1 to 1); None
    if there is no meaningful delay.

    Both are interpolated on a common time grid. The delay is the lag with the highest correlation, up to a third of the
    common time; of lags that fit equally well (a periodic signal), the shortest.
    """
    if min(len(first), len(second)) < _LEAST_POINTS:
        return None, None
    begin, end = max(first_times[0], second_times[0]), min(first_times[-1], second_times[-1])
    if end <= begin:
        return None, None
    # Four points in the shorter period resolve both signals; their number is limited to bound the computing time.
    step = max(min(_period(first_times), _period(second_times)) / 4, (end - begin) / _GRID)
    grid = np.arange(begin, end, step)
    if len(grid) < _LEAST_POINTS:
        return None, None
    one, other = np.interp(grid, first_times, first), np.interp(grid, second_times, second)
    count, most = len(grid), len(grid) // 3
    lags = [*range(-most, most + 1)]
    overlaps = ((one[max(-lag, 0) : count - max(lag, 0)], other[max(lag, 0) : count + min(lag, 0)]) for lag in lags)
    scores = np.array([-2.0 if (score := correlation(*overlap)) is None else score for overlap in overlaps])
    best = float(scores.max())
    if best < 0:
        return None, None
    index = _shortest_peak(scores, best, most)
    lag = float(lags[index])
    if 0 < index < len(scores) - 1:
        # between the points of the grid: the vertex of the parabola through the peak and its neighbours
        left, middle, right = (float(score) for score in scores[index - 1 : index + 2])
        bend = left - 2 * middle + right
        lag += (left - right) / (2 * bend) if bend < 0 else 0.0
    return lag * step, best


def _shortest_peak(scores: Numbers, best: float, middle: int) -> int:
    """Return the index of the highest score; of local maxima that are almost as high, the maximum with the shortest
    delay.
    """
    padded = np.concatenate(([-np.inf], scores, [-np.inf]))
    is_peak = (padded[1:-1] >= padded[:-2]) & (padded[1:-1] >= padded[2:]) & (scores >= _NEAR_BEST * best)
    peaks = np.flatnonzero(is_peak)
    return int(peaks[np.argmin(np.abs(peaks - middle))])


def flat(values: Any) -> Numbers:
    """Return a number, or a list or array of numbers, as a flat array of float64."""
    return np.asarray(values, np.float64).ravel()
