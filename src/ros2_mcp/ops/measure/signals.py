"""The arithmetic of measuring: pure functions on NumPy arrays. Times are in seconds and rise.

Import it inside functions only: NumPy takes a moment, and listing the tools must not wait for it.
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

# A jump is a step larger than this many times the usual step (a robust standard deviation).
JUMP_FACTOR = 8.0
# A value is stuck if it stands still this long (samples, and share of all) although it changes otherwise.
STUCK_SAMPLES = 5
STUCK_SHARE = 0.1
# Of fewer steps none is usual, so that none can be unusual.
_LEAST_STEPS = 3
# Of a value that mostly stands still, one step in a hundred may be a jump; more are its way to move.
_RARE_STEPS = 100
# Share of the messages outside long rests with which a value must change to be one that changes otherwise.
_LIVELY = 0.8
# Share of steps that turn back, above which a value is noisy: of pure noise two in three do, of a smooth one few.
_NOISY = 0.25
# From the median absolute deviation to the standard deviation of a normal distribution: 1 / Φ⁻¹(3/4).
_MAD_TO_SIGMA = 1.4826
# Of fewer points some delay always fits well.
_LEAST_POINTS = 8
# Points at most on which two signals are laid over each other: 0.12 s for one field, measured.
_GRID = 2000
# A peak of this share of the best correlation fits as well: a periodic signal has one for each period.
_NEAR_BEST = 0.98
# Of values scaled to 1 a mean square below this is rounding: doubles are exact to about 1e-16.
_ROUNDING = 1e-28
# Parts of the time that a trend must go through in one direction; of noise one in 5,000 does.
_BLOCKS = 8
# How many standard errors the slope of a trend must be from 0: what noise that goes so by chance never is.
_SURE_SLOPE = 8.0
# A step that is smaller than this part of the largest value is none of the robot, but of its arithmetic: some units in
# the last place of float32, in which much was computed that is sent as float64. Whole numbers are exact.
_ROUNDING_OF = {"float32": 1e-6, "float64": 1e-7}


@dataclass(frozen=True, slots=True)
class Jump:
    """A step much larger than the usual ones, from the value at `since_s` to the next one at `at_s`."""

    since_s: float
    at_s: float
    before: float
    after: float


@dataclass(frozen=True, slots=True)
class Stuck:
    """A value that stood still for `samples` messages although it changes otherwise."""

    at_s: float
    duration_s: float
    samples: int
    value: float


def number(value: Any) -> float | None:
    """A finite number as a float; None for anything else, as JSON has no other."""
    return float(value) if math.isfinite(value) else None


def rounding(path: FieldPath) -> float:
    """Up to which share of its largest value a field's changes may be those of arithmetic."""
    return _ROUNDING_OF.get(path.steps[-1].field.type.base, 0.0)


def jumps(times: Numbers, values: Numbers, rounded: float = 0.0) -> list[Jump]:
    """Steps far out of the usual, and larger than `rounded` of the largest value.

    A value that mostly stands still has one only if it moves once.
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
    """The longest time that a lively value stood still, if that is suspicious.

    It is where the value is noisy otherwise, or leaps when it moves again. A smooth one may just rest, as a robot does.
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
    """The change per second of a value that goes in one direction the whole time, under whatever noise; else None.

    That is where the means of eight parts follow each other, with one step at most in which nothing changes, by more
    than `rounded` of the largest value.
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
    """Indices of times that belong together: each is the other's nearest in time, and they are not far apart.

    Not far is at most half of the longer of the two median periods; without a limit where one has fewer than two times.
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
    """For each time the index of the nearest of the others."""
    if len(others) == 1:
        return np.zeros(len(times), np.intp)
    right = np.minimum(np.maximum(np.searchsorted(others, times), 1), len(others) - 1)
    return np.where(times - others[right - 1] <= others[right] - times, right - 1, right)


def _period(times: Numbers) -> float:
    return float(np.median(np.diff(times)))


def correlation(first: Numbers, second: Numbers) -> float | None:
    """Pearson's correlation; None where one of them does not vary."""
    if len(first) < 2:
        return None
    # as shares of the largest magnitude, so that no square overflows
    one, other = (values / (max(float(values.max()), -float(values.min())) or 1.0) for values in (first, second))
    one -= one.mean()
    other -= other.mean()
    norm = math.sqrt(float(one @ one) * float(other @ other))
    return number(one @ other / norm) if norm > _ROUNDING * len(first) else None


def delay(
    first_times: Numbers, first: Numbers, second_times: Numbers, second: Numbers
) -> tuple[float | None, float | None]:
    """By how many seconds the second signal follows the first, and how well the two agree then (-1 to 1).

    Both are brought onto one grid of times; the lag with the highest correlation counts, up to a third of the time
    they have in common. Of lags that fit equally well (a periodic signal), the shortest.
    """
    if min(len(first), len(second)) < _LEAST_POINTS:
        return None, None
    begin, end = max(first_times[0], second_times[0]), min(first_times[-1], second_times[-1])
    if end <= begin:
        return None, None
    # four points to the shorter period follow both signals; at most as many as can be afforded
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
    """The highest score; of local maxima that are almost as high, the one nearest to no delay."""
    padded = np.concatenate(([-np.inf], scores, [-np.inf]))
    is_peak = (padded[1:-1] >= padded[:-2]) & (padded[1:-1] >= padded[2:]) & (scores >= _NEAR_BEST * best)
    peaks = np.flatnonzero(is_peak)
    return int(peaks[np.argmin(np.abs(peaks - middle))])


def flat(values: Any) -> Numbers:
    """A number, or a list or array of numbers, as a flat array of float64."""
    return np.asarray(values, np.float64).ravel()
