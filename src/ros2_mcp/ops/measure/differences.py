"""Differences between the paired values of two topics: numbers, angles modulo a turn, rotations by the angle between
them.

Import it inside functions only: it needs NumPy.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ros2_mcp.ops.measure import signals
from ros2_mcp.ops.measure.columns import Column, seconds
from ros2_mcp.ops.measure.paired import Paired
from ros2_mcp.ops.measure.signals import Numbers
from ros2_mcp.ops.sources.source import Capture
from ros2_mcp.values.definitions import Definitions
from ros2_mcp.values.select import FieldPath
from ros2_mcp.values.units import unit_of

Kind: TypeAlias = Literal["number", "angle", "rotation"]
Partners: TypeAlias = "tuple[NDArray[np.intp], NDArray[np.intp]]"

_QUATERNION = "geometry_msgs/msg/Quaternion"
_AXES = ("x", "y", "z", "w")
_ANGLE = re.compile(r"(.*_)?(yaw|pitch|roll|heading|theta|bearing|azimuth|angle)(_rad|_deg)?", re.IGNORECASE)
"""Matches field names of directions; other quantities have a further word: `angle_increment`, `yaw_rate`."""
_FLOATS = frozenset({"float32", "float64"})
"""Types of angles in radians; integers are degrees, counts or others."""
_ON_EARTH = re.compile(r"latitude|longitude", re.IGNORECASE)
"""Matches fields whose origin is far away: their magnitude is no measure of a difference."""
_LEAST_ON_EARTH = 1e-3
"""The least scale of percentages for latitude and longitude, in degrees (111 m): the position of a receiver at rest
drifts by metres."""
_LEAST_SCALE = 1e-3
"""The least scale of percentages, as a share of the magnitude: a value that varies less is nearly constant, and
percentages of its noise would mean nothing."""
_ROUNDING = 1e-6
"""The share by which an angle may exceed a turn: float32 rounds π up."""
_UNSET = 1e-6
"""A quaternion shorter than this was never set; a rotation has length 1."""
_SURE = 0.7
"""The least correlation at the best delay for which a delay is reported."""


@dataclass(frozen=True, slots=True)
class Difference:
    """The differences of one field, second minus first, over the pairs that can be compared.

    Differences of angles lie within half a turn to either side; those of rotations are angles from 0 to π. `scale` is
    the reference of percentages: half a turn, or for numbers as in `_scale`. `equal_not_numeric` counts pairs that are
    identical but cannot be subtracted: NaN, the same infinity, a quaternion that was never set.
    """

    field: str
    kind: Kind
    unit: str
    values: Numbers
    scale: float
    correlation: float | None
    delay_s: float | None
    not_compared: int
    equal_not_numeric: int = 0


def differences(first: Capture[Paired], second: Capture[Paired], partners: Partners) -> Iterator[Difference]:
    """Yield the differences of all fields; `partners` are the paired rows of the two captures.

    A quaternion with all four numbers is one rotation. A number is an angle if its name says so (`_ANGLE`) and no value
    in either topic exceeds a turn, as degrees or angles counted over several turns would. If its unit is not known, its
    values must also lie in a range usual for radians: half a turn to either side, or 0 to a full turn.
    """
    sides = [_Side(capture, rows) for capture, rows in zip((first, second), partners, strict=True)]
    paths = [column.path for column in first.kept.columns]
    quaternions = _quaternions(first.type, paths)
    parts = {at for numbers in quaternions.values() for at in numbers}
    for at, path in enumerate(paths):
        name = path.path.rpartition(".")[0]
        if at not in parts:
            turn, has_unit = _turn(first.definitions, first.type, path)
            yield _of_numbers(at, *sides, turn=turn, has_unit=has_unit)
        elif at == min(quaternions[name]):
            yield _of_rotations(name or ", ".join(_AXES), quaternions[name], *sides)


@dataclass(frozen=True, slots=True)
class _Side:
    """One of the two topics, and its rows that have a partner."""

    capture: Capture[Paired]
    rows: NDArray[np.intp]

    def column(self, number: int) -> Column:
        return self.capture.kept.columns[number]

    def times(self, rows: NDArray[Any]) -> Numbers:
        """Return the receive times of rows, in s from the start of the capture."""
        return seconds(self.capture.kept.read_ns[rows], self.capture.start_ns)

    def series(self, number: int, turn: float) -> tuple[Numbers, Numbers]:
        """Return times and finite values of a field that is no list; angles are unwrapped."""
        rows, values = self.column(number).rows, self.column(number).values
        finite = np.isfinite(values)
        if not finite.all():
            rows, values = rows[finite], values[finite]
        return self.times(rows), np.unwrap(values, period=turn) if turn else values


def _quaternions(type_name: str, paths: Sequence[FieldPath]) -> dict[str, list[int]]:
    """Return the columns of x, y, z, w of each quaternion, by its name; the name is empty if the message itself is a
    quaternion.
    """
    found: dict[str, dict[str, int]] = {}
    for at, path in enumerate(paths):
        inside = path.steps[-2].type.base if len(path.steps) > 1 else type_name
        if inside == _QUATERNION:
            name, _, axis = path.path.rpartition(".")
            found.setdefault(name, {})[axis] = at
    return {name: [axes[axis] for axis in _AXES] for name, axes in found.items() if set(axes) == set(_AXES)}


def _turn(definitions: Definitions, type_name: str, path: FieldPath) -> tuple[float, bool]:
    """Return the length of a full turn in the unit of an angle field, and whether that unit is known; 0 if the field is
    no angle.
    """
    last = path.steps[-1].field
    if last.type.base not in _FLOATS or not _ANGLE.fullmatch(last.name):
        return 0.0, False
    unit = unit_of(definitions, type_name, path.path)
    return {"": math.tau, "rad": math.tau, "°": 360.0}.get(unit, 0.0), bool(unit)


def _is_turning(turn: float, has_unit: bool, sides: Sequence[Numbers]) -> bool:
    """Return whether these values can be angles with that turn."""
    least = min((float(side.min()) for side in sides if len(side)), default=0.0)
    most = max((float(side.max()) for side in sides if len(side)), default=0.0)
    turn *= 1 + _ROUNDING
    if has_unit:
        return -turn <= least and most <= turn
    return -turn / 2 <= least and most <= (turn if least >= 0 else turn / 2)


def _scale(path: FieldPath, sides: Sequence[Numbers]) -> float:
    """Return the reference of percentages of numbers: the range of values within a topic, the larger of the two.

    It is at most the largest magnitude and at least a thousandth of that; the magnitude if neither topic varies. For
    latitude and longitude the magnitude is not used.
    """
    kept = [side for side in sides if len(side)]
    magnitude = max((float(np.abs(side).max()) for side in kept), default=0.0)
    spread = max((float(side.max()) - float(side.min()) for side in kept), default=0.0)
    if _ON_EARTH.fullmatch(path.steps[-1].field.name):
        return max(spread, _LEAST_ON_EARTH)
    if spread <= signals.rounding(path) * magnitude:
        return magnitude
    return min(max(spread, _LEAST_SCALE * magnitude), magnitude)


def _of_numbers(number: int, first: _Side, second: _Side, *, turn: float, has_unit: bool) -> Difference:
    path = first.column(number).path
    one, other, not_compared = _paired(number, first, second)
    equal_not_numeric = 0
    with np.errstate(over="ignore", invalid="ignore"):  # differences at the ends of the range may be infinite
        both = np.isfinite(one) & np.isfinite(other)
        if not both.all():
            equal_not_numeric = int(np.count_nonzero(~both & _alike(one, other)))
            not_compared += int(np.count_nonzero(~both)) - equal_not_numeric
            one, other = one[both], other[both]
        turn = turn if _is_turning(turn, has_unit, (one, other)) else 0.0
        scale = turn / 2 or _scale(path, (one, other))
        difference = other - one
        if turn:
            difference -= turn * np.round(difference / turn)
            one = np.unwrap(one, period=turn)
            other = one + difference
    correlation, unit = signals.correlation(one, other), {math.tau: "rad", 360.0: "°"}.get(turn, "")
    del one, other  # for a million messages these take 16 MB
    delay_s = None
    if not path.is_list and len(difference):
        delay_s = _delay(*first.series(number, turn), *second.series(number, turn))
    kind = "angle" if turn else "number"
    return Difference(path.path, kind, unit, difference, scale, correlation, delay_s, not_compared, equal_not_numeric)


def _of_rotations(name: str, numbers: Sequence[int], first: _Side, second: _Side) -> Difference:
    found = [_paired(each, first, second) for each in numbers]
    one, other = (np.array([row[side] for row in found]) for side in (0, 1))
    usable = _usable(one) & _usable(other)
    equal_not_numeric = int(np.count_nonzero(~usable & _alike(one, other).all(axis=0)))
    not_compared = found[0][2] + int(np.count_nonzero(~usable)) - equal_not_numeric
    angles, delay_s = _angles(one[:, usable], other[:, usable]), None
    if not first.column(numbers[0]).path.is_list and len(angles):
        # The series is the angle from one orientation, which does not depend on the sign of a quaternion.
        origin = one[:, np.flatnonzero(usable)[:1]]
        series: list[Numbers] = []
        for side in (first, second):
            turned = np.array([side.column(each).values for each in numbers])
            kept = _usable(turned)
            series += [side.times(side.column(numbers[0]).rows[kept]), _angles(turned[:, kept], origin)]
        delay_s = _delay(*series)
    return Difference(name, "rotation", "rad", angles, math.pi, None, delay_s, not_compared, equal_not_numeric)


def _usable(quaternions: Numbers) -> NDArray[np.bool_]:
    length = np.sqrt((quaternions**2).sum(axis=0))
    return np.isfinite(length) & (length > _UNSET)


def _angles(one: Numbers, other: Numbers) -> Numbers:
    """Return the angles between rotations, from 0 to π; q and −q are the same rotation."""
    one, other = one / np.sqrt((one**2).sum(axis=0)), other / np.sqrt((other**2).sum(axis=0))
    apart = np.minimum(((one - other) ** 2).sum(axis=0), ((one + other) ** 2).sum(axis=0))
    # computed from the chord, because the arc cosine of the dot product is inexact for small angles
    return 4 * np.arcsin(np.minimum(np.sqrt(apart) / 2, 1.0))


def _alike(one: Numbers, other: Numbers) -> NDArray[np.bool_]:
    return (one == other) | (np.isnan(one) & np.isnan(other))


def _paired(number: int, first: _Side, second: _Side) -> tuple[Numbers, Numbers, int]:
    """Return the values of both topics over the paired messages, element by element, and the number of pairs with
    different lengths.
    """
    begins: list[NDArray[np.int32]] = []
    counts: list[NDArray[np.int32]] = []
    for side in (first, second):
        begin, count = side.column(number).by_row(side.capture.kept.rows)
        begins.append(begin[side.rows])
        counts.append(count[side.rows])
    same = counts[0] == counts[1]
    one, other = (
        side.column(number).values[_spans(begin[same], counts[0][same])]
        for side, begin in zip((first, second), begins, strict=True)
    )
    return one, other, int(np.count_nonzero(~same))


def _spans(begins: NDArray[np.int32], counts: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return the indices of all elements of spans, each with its first index and its number of elements."""
    ends = np.cumsum(counts, dtype=np.int32)
    found = np.repeat(begins - (ends - counts), counts)
    found += np.arange(len(found), dtype=np.int32)
    return found


def _delay(first_times: Numbers, first: Numbers, second_times: Numbers, second: Numbers) -> float | None:
    delay_s, score = signals.delay(first_times, first, second_times, second)
    return delay_s if score is not None and score >= _SURE else None
