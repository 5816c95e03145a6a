"""The curve along which joints move through the points of a trajectory, and its true extremes. Needs no ROS.

A joint trajectory controller (ros2_controllers) interpolates between two points by what both of them contain: a
straight line for positions alone, a cubic with velocities, a quintic with velocities and accelerations. The first
segment begins where the joints are when the trajectory arrives; after the last point they stay there. Between points
such a curve may be far faster, and lead far farther, than the points themselves. See
docs/decisions/0061-the-whole-curve-is-judged.md.

Each segment is a polynomial of s, its share of the time from 0 to 1. Extremes are at its ends, or at the roots of its
derivative. Positions are in rad (m for prismatic joints), speeds and accelerations per second.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

Polynomial = Sequence[float]
"""Coefficients of 1, s, s², …"""

# Coefficients smaller than this, relative to the largest, are rounding errors of zero.
_NOTHING = 1e-13
# A root is accurate enough when its interval, or Newton's last step, is narrower than this share of the segment.
_NARROW = 1e-12
# The most steps to a root: Newton's method converges in about six, bisection alone would need 40.
_STEPS = 60


# ── polynomials on 0 ≤ s ≤ 1 ───────────────────────────────────────────────────────────────────────────────────────


def derivative(polynomial: Polynomial) -> Polynomial:
    """Return the derivative of a polynomial with respect to s."""
    return [power * factor for power, factor in enumerate(polynomial)][1:]


def at(polynomial: Polynomial, s: float) -> float:
    """Return the value of a polynomial at s."""
    value = 0.0
    for factor in reversed(polynomial):
        value = value * s + factor
    return value


def extremes(polynomial: Polynomial) -> tuple[float, float]:
    """Return the least and the largest value of a polynomial for s from 0 to 1."""
    values = [at(polynomial, s) for s in (0.0, *roots(derivative(polynomial)), 1.0)]
    return min(values), max(values)


def hull(polynomial: Polynomial) -> tuple[float, float]:
    """Return bounds on a polynomial's values for s from 0 to 1, without finding roots: the
    extreme Bernstein coefficients.
    """
    weights = _BERNSTEIN[len(polynomial)]
    found = [sum(weight * factor for weight, factor in zip(row, polynomial, strict=False)) for row in weights]
    return min(found), max(found)


_BERNSTEIN = [
    [[math.comb(row, power) / math.comb(size - 1, power) for power in range(row + 1)] for row in range(size)]
    for size in range(7)
]
"""Matrices that turn coefficients into Bernstein coefficients, indexed by the number of coefficients."""


def roots(polynomial: Polynomial) -> list[float]:
    """Return the roots of a polynomial strictly between 0 and 1, in ascending order.

    A root without a change of sign may be missing: a polynomial with this derivative has no extreme there.
    """
    largest = max(map(abs, polynomial), default=0.0)
    size = len(polynomial)
    while size and abs(polynomial[size - 1]) <= _NOTHING * largest:
        size -= 1
    polynomial = polynomial[:size]
    if size <= 1:
        return []
    if size == 2:
        found = [-polynomial[0] / polynomial[1]]
    elif size == 3:
        found = _of_quadratic(*polynomial)
    else:
        low, high = hull(polynomial)
        if low > 0 or high < 0:
            return []
        found = list(_between(polynomial, [0.0, *roots(derivative(polynomial)), 1.0]))
    return [s for s in found if 0.0 < s < 1.0]


def _of_quadratic(c: float, b: float, a: float) -> list[float]:
    discriminant = b * b - 4 * a * c
    if discriminant < 0:
        return []
    q = -0.5 * (b + math.copysign(math.sqrt(discriminant), b))
    return sorted({q / a, *([c / q] if q else [])})


def _between(polynomial: Polynomial, places: Sequence[float]) -> Iterator[float]:
    """Yield the roots between consecutive places; the polynomial is monotonic between two of them."""
    slope = derivative(polynomial)
    for low, high in pairwise(places):
        left, right = at(polynomial, low), at(polynomial, high)
        if left == 0.0:
            yield low
        if left * right < 0.0:
            yield _root(polynomial, slope, low, high, rises=left < 0.0)


def _root(polynomial: Polynomial, slope: Polynomial, low: float, high: float, *, rises: bool) -> float:
    """Return the root between two places with values of different signs.

    Takes Newton's steps as long as they stay between, otherwise bisects.
    """
    s = 0.5 * (low + high)
    for _ in range(_STEPS):
        value = at(polynomial, s)
        if value == 0.0 or high - low < _NARROW:
            break
        low, high = (s, high) if (value < 0.0) == rises else (low, s)
        steep = at(slope, s)
        newton = s - value / steep if steep else math.inf
        if low < newton < high:
            is_near, s = abs(newton - s) < _NARROW, newton
            if is_near:
                break
        else:
            s = 0.5 * (low + high)
    return s


# ── one joint ──────────────────────────────────────────────────────────────────────────────────────────────────────


class State(NamedTuple):
    """The state of a joint at a point of a trajectory; None: the point does not contain the value."""

    position: float
    speed: float | None = None
    acceleration: float | None = None


@dataclass(frozen=True)
class Segment:
    """The motion of one joint from one point to the next, in `seconds`."""

    seconds: float
    position: Polynomial

    @property
    def speed(self) -> Polynomial:
        """The polynomial of the speed times `seconds`."""
        return derivative(self.position)

    @property
    def acceleration(self) -> Polynomial:
        """The polynomial of the acceleration times `seconds` squared."""
        return derivative(self.speed)

    @property
    def is_straight(self) -> bool:
        """Whether the speed is constant."""
        return len(self.position) == 2


def segment(start: State, end: State, seconds: float) -> Segment:
    """Return the segment that a controller interpolates, according to what both ends contain."""
    way = end.position - start.position
    if start.speed is None or end.speed is None:
        return Segment(seconds, (start.position, way))
    out, into = start.speed * seconds, end.speed * seconds
    if start.acceleration is None or end.acceleration is None:
        return Segment(seconds, (start.position, out, 3 * way - 2 * out - into, out + into - 2 * way))
    first, last = start.acceleration * seconds**2, end.acceleration * seconds**2
    return Segment(
        seconds,
        (
            start.position,
            out,
            first / 2,
            10 * way - 6 * out - 4 * into - (3 * first - last) / 2,
            -15 * way + 8 * out + 7 * into + (3 * first - 2 * last) / 2,
            6 * way - 3 * (out + into) - (first - last) / 2,
        ),
    )


def segments(start: State, end: State, seconds: float) -> Iterator[Segment]:
    """Yield every segment that a controller may interpolate, if it is not known which.

    The first is that of ros2_controllers. If only one end has speeds or accelerations, the
    second has zeros at the other.
    """
    yield segment(start, end, seconds)
    is_fast = (start.speed is None) != (end.speed is None)
    is_bent = (start.acceleration is None) != (end.acceleration is None)
    if is_fast or is_bent:
        yield segment(_filled(start, is_fast, is_bent), _filled(end, is_fast, is_bent), seconds)


def _filled(state: State, with_speed: bool, with_acceleration: bool) -> State:
    """Return the state with zeros for missing values."""
    position, speed, acceleration = state
    speed = 0.0 if speed is None and with_speed else speed
    return State(position, speed, 0.0 if acceleration is None and with_acceleration else acceleration)
