"""Limits on the fields of a value, and how a value beyond them is clamped. Needs no ROS.

The same functions judge values as JSON objects in the server, and messages decoded by rclpy in the bridge. A path names
fields: `linear.x`, `points[].velocities[]` (each element), "" for the whole value. For a stamped type (a header and one
more field) the name of that field may be omitted: `linear` of a `TwistStamped` means `twist.linear`. A value that
cannot be judged is refused: a missing field, a string instead of a number, NaN.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from ros2_mcp_common.policy.curves import extremes, segments
from ros2_mcp_common.policy.field_values import (
    Unfit,
    at,
    fields_of,
    get,
    is_list,
    number_at,
    numbers,
    steps_of,
    with_frame_ids,
)
from ros2_mcp_common.policy.keep_out import KeepOut, problem_of_goal
from ros2_mcp_common.policy.polygons import distance, is_inside
from ros2_mcp_common.policy.trajectory_limits import CurveLimits, LookAtJoints, nobody_measures, seconds, states_at
from ros2_mcp_common.policy.trajectory_limits import problem as problem_of_curve

# A vector is scaled to this share of its limit, so that rounding to float32 (6e-8) leaves it within.
_WITHIN = 1 - 1e-6
# A tolerance for rounded times of trajectories: 1 ns in 1 s.
_ROUNDING = 1 + 1e-9


@dataclass(frozen=True)
class Zone:
    """A polygon in a coordinate frame, in metres; a position has to lie in it, at least `margin_m` from its edges."""

    frame_id: str
    polygon: tuple[tuple[float, float], ...]
    margin_m: float = 0.0


@dataclass(frozen=True)
class Pace:
    """A limit on a list of trajectory points (`positions`, `time_from_start`).

    No joint may move faster than `most` (rad/s or m/s) anywhere between two points. The first point, whose distance is
    not known, has to come `first_s` after the start or later.
    """

    most: float
    first_s: float


@dataclass(frozen=True)
class Checks:
    """The limits on the fields of a value, each by the path of the field.

    `norm`: the largest length of the vector of all numbers at or below the path. `range`: the inclusive bounds of each
    number. `one_of`: the allowed values. `zero`: all numbers at or below the path are 0. `count`: the least and largest
    number of elements of a list. `zone`: the name of the zone in which the position lies. `pace`, `curve`: limits on
    trajectories, see `Pace` and `CurveLimits`. `keep_out`: the zones that the whole value, a goal, may not lead into.
    """

    norm: Mapping[str, float] = field(default_factory=dict[str, float])
    range: Mapping[str, tuple[float, float]] = field(default_factory=dict[str, "tuple[float, float]"])
    one_of: Mapping[str, tuple[Any, ...]] = field(default_factory=dict[str, "tuple[Any, ...]"])
    zero: tuple[str, ...] = ()
    count: Mapping[str, tuple[int, int]] = field(default_factory=dict[str, "tuple[int, int]"])
    zone: Mapping[str, str] = field(default_factory=dict[str, str])
    pace: Mapping[str, Pace] = field(default_factory=dict[str, Pace])
    curve: Mapping[str, CurveLimits] = field(default_factory=dict[str, CurveLimits])
    keep_out: KeepOut | None = None

    @property
    def is_empty(self) -> bool:
        """Whether there are no limits."""
        by_path = (self.norm, self.range, self.one_of, self.zero, self.count, self.zone, self.pace, self.curve)
        return not any(by_path) and self.keep_out is None


# ── judging ────────────────────────────────────────────────────────────────────────────────────────────────────────


def problem(checks: Checks, value: Any, zones: Mapping[str, Zone], look: LookAtJoints = nobody_measures) -> str:
    """Return in words which limit a value exceeds, beginning with the path; "" if it exceeds none.

    `look` returns the joint states from which a trajectory is judged.
    """
    try:
        return next(_problems(checks, value, zones, look), "")
    except Unfit as unfit:
        return str(unfit)


def _problems(checks: Checks, value: Any, zones: Mapping[str, Zone], look: LookAtJoints) -> Iterator[str]:
    for bounds, judge in _by_path(checks):
        for path, bound in bounds.items():
            for shown, found in at(value, path):
                yield from judge(shown, found, bound)
    for path, name in checks.zone.items():
        for shown, found, frame_id in with_frame_ids(value, path):
            if reason := outside(found, frame_id, zones[name]):
                yield f"{shown or 'the position'} {reason} (zone {name})"
    for path, limits in checks.curve.items():
        for shown, found in at(value, path):
            if reason := problem_of_curve(found, limits, look):
                yield f"{shown or 'the trajectory'}: {reason}"
    if checks.keep_out and (reason := problem_of_goal(checks.keep_out, value)):
        yield reason


def _by_path(checks: Checks) -> Sequence[tuple[Mapping[str, Any], Callable[[str, Any, Any], Iterator[str]]]]:
    """Return the limits by path, each with the function that judges it."""
    return [
        (checks.norm, _too_long),
        (dict.fromkeys(checks.zero, (0.0, 0.0)), _out_of_range),
        (checks.range, _out_of_range),
        (checks.one_of, _none_of),
        (checks.count, _too_many),
        (checks.pace, _too_fast),
    ]


def _too_long(shown: str, found: Any, most: float) -> Iterator[str]:
    length = _length(numbers(found, shown))
    if not length <= most:
        yield f"{shown or 'its length'} is {length:.6g}, at most {most:g} is allowed"


def _out_of_range(shown: str, found: Any, bounds: tuple[float, float]) -> Iterator[str]:
    low, high = bounds
    for path, number in numbers(found, shown):
        if not low <= number <= high:
            yield f"{path} is {number:.6g}, {f'{low:g} to {high:g}' if low != high else f'only {low:g}'} is allowed"


def _none_of(shown: str, found: Any, allowed: tuple[Any, ...]) -> Iterator[str]:
    if not any(_is_same(found, one) for one in allowed):
        yield f"{shown} is {_shown(found)}, only {' or '.join(map(_shown, allowed))} is allowed"


def _too_many(shown: str, found: Any, bounds: tuple[int, int]) -> Iterator[str]:
    fewest, most = bounds
    many = len(found) if is_list(found) else -1
    if not fewest <= many <= most:
        yield f"{shown} has {many} elements, {fewest} to {most} are allowed"


def _length(found: Iterator[tuple[str, float]]) -> float:
    """Return the length of a vector: infinite if it overflows, NaN if one of its numbers is NaN."""
    return math.hypot(*(number for _, number in found))


def _is_same(found: Any, allowed: Any) -> bool:
    """Return whether two values are equal. Unlike in Python, True is not equal to 1."""
    if isinstance(found, bool) or isinstance(allowed, bool):
        return found is allowed
    return bool(found == allowed)


def _shown(value: Any) -> str:
    """Return a value as text to put into a sentence: strings in quotes and escaped to ASCII, cut with … above 60
    characters.
    """
    return ascii(value) if len(ascii(value)) <= 60 else f"{ascii(value)[:57]}…"


def outside(position: Any, frame_id: str, zone: Zone) -> str:
    """Return why a position (a point, a pose, or either with a stamp) is not in the zone; "" if it is."""
    if frame_id != zone.frame_id:
        return f"is in the frame {_shown(frame_id)}, only {_shown(zone.frame_id)} can be judged"
    for step in ("pose", "point", "position"):
        if step in fields_of(position):
            position = get(position, step)
    if "pose" in fields_of(position):  # in a PoseWithCovariance
        position = get(get(position, "pose"), "position")
    x, y = (number_at(position, axis, axis) for axis in ("x", "y"))
    if not (math.isfinite(x) and math.isfinite(y)):
        return "is not a finite position"
    if not is_inside(x, y, zone.polygon):
        return f"({x:.6g}, {y:.6g}) lies outside"
    nearest = distance(x, y, zone.polygon)
    return (
        f"is {nearest:.3g} m from the edge, at least {zone.margin_m:g} m is needed" if nearest < zone.margin_m else ""
    )


def _too_fast(shown: str, points: Any, pace: Pace) -> Iterator[str]:
    if not is_list(points) or not len(points):
        yield f"{shown} has no points"
        return
    before_s, before = 0.0, None
    for place, point in enumerate(points):
        here = f"{shown}[{place}]"
        now_s = seconds(point, here)
        now = states_at(point, len(get(point, "positions")), here)
        if before is None:
            if not now_s * _ROUNDING >= pace.first_s:
                yield f"{here} comes after {now_s:g} s, at least {pace.first_s:g} s is needed for the way there"
        elif len(now) != len(before):
            yield f"{here} has {len(now)} positions, the one before has {len(before)}"
        elif not now_s > before_s:
            yield f"{here} comes no later than the point before: it is reached faster than {pace.most:g} per second"
        else:
            most = pace.most * (now_s - before_s) * _ROUNDING
            for joint, states in enumerate(zip(before, now, strict=True)):
                curves = [extremes(way.speed) for way in segments(*states, now_s - before_s)]
                if not all(-most <= low and high <= most for low, high in curves):
                    yield f"{here}.positions[{joint}] is reached faster than {pace.most:g} per second"
        before_s, before = now_s, now


# ── bringing within ────────────────────────────────────────────────────────────────────────────────────────────────


def clamp(checks: Checks, value: Any) -> bool:
    """Change a value in place so that it is within its `zero`, `norm` and `range`, as far as possible.

    Return True if the value was not within these limits before and is now.

    All vectors with a `norm`, and the numbers with a `range` below them, are scaled by one factor, so that a robot
    keeps the curvature of its path. Any other number with a `range` is set to its nearest bound. NaN is not changed.
    """
    scaled = Checks(norm=checks.norm, range=checks.range, zero=checks.zero)
    if scaled.is_empty or not problem(scaled, value, {}):
        return False
    try:
        for path in checks.zero:
            for parent, name in _places(value, path):
                _put_scaled(parent, name, 0.0)
        _scale(checks, value)
        for path, (low, high) in checks.range.items():
            for parent, name in _places(value, path):
                number = number_at(parent, name, path)
                if not low <= number <= high and not math.isnan(number):
                    _put(parent, name, type(get(parent, name))(min(high, max(low, number))))
    except (Unfit, TypeError, ValueError, AssertionError):  # the last three: the message rejects the value
        return False
    return not problem(scaled, value, {})


def _put(value: Any, name: str, changed: Any) -> None:
    if isinstance(value, dict):
        value[name] = changed
    else:
        setattr(value, name, changed)


def _scale(checks: Checks, value: Any) -> None:
    """Scale every vector with a `norm` by one factor that brings all vectors, and ranges below them, within limits."""
    factor = 1.0
    for path, most in checks.norm.items():
        for _, found in at(value, path):
            length = _length(numbers(found, path))
            factor = min(factor, most / length * _WITHIN) if length > most else factor
    for path, (low, high) in checks.range.items():
        if not (_has_norm(path, checks) and low <= 0 <= high):
            continue
        for _, number in (below for _, found in at(value, path) for below in numbers(found, path)):
            bound = high if number > 0 else low
            factor = min(factor, bound / number * _WITHIN) if not low <= number <= high and number else factor
    if factor < 1:
        for parent, name in (place for path in checks.norm for place in _places(value, path)):
            _put_scaled(parent, name, factor)


def _has_norm(path: str, checks: Checks) -> bool:
    return any(path == norm or path.startswith(f"{norm}.") for norm in checks.norm)


def _put_scaled(parent: Any, name: str, factor: float) -> None:
    number = get(parent, name)
    scaled = float(number) * factor if factor else 0.0
    _put(parent, name, scaled if isinstance(number, float) else int(scaled))


def _places(value: Any, path: str) -> Iterator[tuple[Any, str]]:
    """Yield, for each number at or below a path, the object or message that contains it and the name of its field.

    Raises:
        Unfit: if the path leads into a list.
    """
    steps = steps_of(value, path)
    if "[]" in steps:
        raise Unfit(f"{path} cannot be changed")
    for step in steps[:-1]:
        value = get(value, step)
    yield from _leaves(value, steps[-1:] or fields_of(value))


def _leaves(value: Any, names: Sequence[str]) -> Iterator[tuple[Any, str]]:
    for name in names:
        below = get(value, name)
        if fields_of(below):
            yield from _leaves(below, fields_of(below))
        else:
            yield value, name
