"""Axes: which range to show, where to put ticks, and how to write them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_PADDING = 0.05
_LARGEST = 8e307
"""Beyond it the span of an axis would not be finite."""
_LONGEST_LABEL = 9


@dataclass(frozen=True, slots=True)
class Span:
    """The part of an axis that is shown, `low` less than `high`."""

    low: float
    high: float

    @property
    def length(self) -> float:
        """How much it shows."""
        return self.high - self.low


def span_of(values: Sequence[NDArray[np.float64]]) -> Span:
    """A span in which all finite values lie, with a little room around them; 0 to 1 if there are none."""
    lows, highs = zip(*(_bounds(each) for each in values), strict=True) if values else ((), ())
    low, high = min(lows, default=math.inf), max(highs, default=-math.inf)
    if low > high:
        return Span(0.0, 1.0)
    room = (high - low) * _PADDING
    if room <= max(abs(low), abs(high)) * 1e-13:
        room = max(abs(low), abs(high)) * _PADDING or 1.0
    return Span(low - room, high + room)


def _bounds(values: NDArray[np.float64]) -> tuple[float, float]:
    finite = values[np.isfinite(values)]
    if not len(finite):
        return math.inf, -math.inf
    return max(float(finite.min()), -_LARGEST), min(float(finite.max()), _LARGEST)


def ticks(span: Span, most: int) -> list[float]:
    """Round numbers inside the span, evenly spaced (1, 2 or 5 times a power of ten): about `most`, at least two."""
    step = _step(span.length / max(most, 3))
    if len(_multiples(span, step)) < 2:
        step = _step(span.length / max(2 * most, 6))
    return [index * step for index in _multiples(span, step)]


def _multiples(span: Span, step: float) -> range:
    return range(math.ceil(span.low / step), math.floor(span.high / step) + 1)


def _step(least: float) -> float:
    power = 10.0 ** math.floor(math.log10(least))
    return next(factor * power for factor in (1, 2, 5, 10) if factor * power >= least * (1 - 1e-9))


def labels(values: Sequence[float]) -> list[str]:
    """Two or more ticks as text, each with the decimals that the step between them needs."""
    step = values[1] - values[0]
    largest = max(map(abs, values))
    decimals = max(0, -math.floor(math.log10(step) + 1e-9))
    whole = len(f"{largest:.0f}") if largest < 1e15 else _LONGEST_LABEL
    if whole + decimals <= _LONGEST_LABEL:
        return [_without_minus(f"{value:.{decimals}f}") for value in values]
    digits = max(0, math.floor(math.log10(largest) + 1e-9) - math.floor(math.log10(step) + 1e-9))
    return ["0" if value == 0 else f"{value:.{digits}e}" for value in values]


def _without_minus(label: str) -> str:
    return label[1:] if label.startswith("-") and not label.strip("-0.") else label
