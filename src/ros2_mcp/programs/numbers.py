"""Numeric functions for programs: programs have no numeric library.

Each function of `NUMBERS` is in the module `robot` under its name there. Values that are not finite numbers are
ignored: NaN and infinities, also as texts ("nan", "inf"), and None, all of which messages contain. Angles are in rad.
Points and quaternions are dicts or messages with x, y, z, w.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, cast

from ros2_mcp_common.geometry import yaw_rad

Values = Iterable[Any]


def finite(values: Values) -> list[float]:
    """The values that are finite numbers, in their order."""
    return [float(value) for value in values if _is_finite(value)]


def least(values: Values) -> float:
    """The smallest value."""
    return min(_some(values))


def greatest(values: Values) -> float:
    """The largest value."""
    return max(_some(values))


def mean(values: Values) -> float:
    """The arithmetic mean."""
    found = _some(values)
    return math.fsum(found) / len(found)


def deviation(values: Values) -> float:
    """The standard deviation of all values (of the population, not a sample); 0 for one value."""
    found = _some(values)
    middle = math.fsum(found) / len(found)
    return math.sqrt(math.fsum((value - middle) ** 2 for value in found) / len(found))


def percentile(values: Values, percent: float) -> float:
    """The value below which that percentage of the values lies, interpolated linearly; 50 is the median."""
    if not 0 <= percent <= 100:
        raise ValueError(f"percent is {percent}: give 0 to 100")
    found = sorted(_some(values))
    place = (len(found) - 1) * percent / 100
    low = math.floor(place)
    high = min(low + 1, len(found) - 1)
    return found[low] + (found[high] - found[low]) * (place - low)


def slope(values: Sequence[Any], times_s: Sequence[Any]) -> float:
    """The change per second: the slope of the least-squares line through values at times in seconds."""
    if len(values) != len(times_s):
        raise ValueError(f"{len(values)} values and {len(times_s)} times: give as many of each")
    pairs = [(float(t), float(v)) for t, v in zip(times_s, values, strict=True) if _is_finite(t) and _is_finite(v)]
    if len({t for t, _ in pairs}) < 2:
        raise ValueError("a slope needs values at two times or more")
    middle_t = math.fsum(t for t, _ in pairs) / len(pairs)
    middle_v = math.fsum(v for _, v in pairs) / len(pairs)
    return math.fsum((t - middle_t) * (v - middle_v) for t, v in pairs) / math.fsum(
        (t - middle_t) ** 2 for t, _ in pairs
    )


def normalize_angle(angle_rad: float) -> float:
    """The same angle in (-pi, pi]."""
    turned = math.remainder(_number(angle_rad), math.tau)
    return math.pi if turned == -math.pi else turned


def angle_difference(from_rad: float, to_rad: float) -> float:
    """The shortest rotation from one angle to another, counter-clockwise positive, in (-pi, pi]."""
    return normalize_angle(_number(to_rad) - _number(from_rad))


def mean_angle(values: Values) -> float:
    """The mean angle; that of pi and -pi is pi, not 0."""
    found = _some(values)
    x, y = math.fsum(map(math.cos, found)), math.fsum(map(math.sin, found))
    if math.hypot(x, y) < 1e-9 * len(found):  # the rounding error of directions that cancel each other
        raise ValueError("these directions have no mean: they cancel each other")
    return normalize_angle(math.atan2(y, x))


def yaw(orientation: Any) -> float:
    """The heading of a quaternion, or of a value with an orientation (pose, odometry) or rotation (transform)."""
    x, y, z, w = (_number(part) for part in _parts(_quaternion(orientation), ("x", "y", "z", "w")))
    if not math.isfinite(length := math.hypot(x, y, z, w)) or length < 1e-6:
        raise ValueError("this quaternion has length 0: it was never filled in")
    return yaw_rad(x, y, z, w)


def distance(one: Any, other: Any) -> float:
    """The distance between two points with x, y and optionally z, in their unit; also between poses."""
    return math.dist(_point(one), _point(other))


NUMBERS: Mapping[str, Callable[..., Any]] = {
    "finite": finite,
    "min": least,
    "max": greatest,
    "mean": mean,
    "std": deviation,
    "percentile": percentile,
    "slope": slope,
    "normalize_angle": normalize_angle,
    "angle_difference": angle_difference,
    "mean_angle": mean_angle,
    "yaw": yaw,
    "distance": distance,
}
"""From the name in the module `robot` to the function."""


_WRAPPERS = ("orientation", "rotation", "pose", "transform")
"""The fields that may contain a quaternion: in an Odometry it is pose.pose.orientation."""
_POINT_WRAPPERS = ("position", "translation", "point", "pose", "transform")


def _some(values: Values) -> list[float]:
    if isinstance(values, (str, bytes, Mapping)):
        raise TypeError(f"values are a list of numbers, not {type(cast('object', values)).__name__}")
    found = finite(values)
    if not found:
        raise ValueError("there is no finite number among the values")
    return found


def _is_finite(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def _number(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise TypeError(f"a number is expected, not {value!r}"[:200])
    return float(value)


def _quaternion(found: Any) -> Any:
    return _within(found, _WRAPPERS, "w")


def _point(found: Any) -> list[float]:
    """Return the x, y, z of a point: a list of 2 or 3 numbers, or a message. A missing z is 0."""
    found = _within(found, _POINT_WRAPPERS, "y")
    if isinstance(found, (list, tuple)):
        numbers = [_number(part) for part in cast("Sequence[Any]", found)]
        if len(numbers) not in (2, 3):
            raise ValueError(f"a point has 2 or 3 numbers, not {len(numbers)}")
        return [*numbers, 0.0][:3]
    return [_number(part) for part in (*_parts(found, ("x", "y")), _get(found, "z", 0.0))]


def _within(found: Any, wrappers: Sequence[str], part: str) -> Any:
    """Return the innermost message that has the field `part`: in an Odometry it is three levels deep."""
    for _ in wrappers:
        if _get(found, part, None) is not None:
            break
        inner = next((_get(found, name, None) for name in wrappers if _get(found, name, None) is not None), None)
        if inner is None:
            break
        found = inner
    return found


def _parts(found: Any, names: Sequence[str]) -> list[Any]:
    if isinstance(found, (list, tuple)) and len(cast("Sequence[Any]", found)) == len(names):
        return list(cast("Sequence[Any]", found))
    parts = [_get(found, name, None) for name in names]
    if missing := [name for name, part in zip(names, parts, strict=True) if part is None]:
        raise ValueError(f"there is no {missing[0]} in {found!r}"[:200])
    return parts


def _get(found: Any, name: str, otherwise: Any) -> Any:
    if isinstance(found, Mapping):
        return cast("Mapping[str, Any]", found).get(name, otherwise)
    return getattr(found, name, otherwise)
