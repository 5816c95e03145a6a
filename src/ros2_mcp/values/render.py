"""Convert message objects to JSON of bounded size: long values are replaced by a summary, never cut in the middle.

Numbers are exact and short: `0` for 0.0, a diagonal matrix as its diagonal (`$diagonal`). NaN and the infinities are
the strings `"nan"`, `"inf"`, `"-inf"` (see `_json_number`, and `NOT_FINITE` in `model/values.py`).
"""

from __future__ import annotations

import base64
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from struct import Struct
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ros2_mcp.model.interfaces import FLOATS, OCTETS, TEXTS, FieldType
from ros2_mcp.model.text import escaped_bytes, is_unicode, visible_json
from ros2_mcp.model.values import DIAGONAL, EXACT_INTEGER, FIRST_ELEMENTS, SUMMARY, is_covariance, not_finite_text
from ros2_mcp.values.check import check
from ros2_mcp.values.definitions import Definitions
from ros2_mcp.values.select import FieldPath, Step, element_at, parse_fields, several_of
from ros2_mcp.values.store import attribute
from ros2_mcp_common.language.scans import no_bearings

_BYTES_AS_LIST = 64
"""Up to this many bytes are a readable list (a UUID); more are base64, a third as long."""
_MOST_FIRST = 16
"""First values in a summary, which show what the numbers are like. A slice in `fields` gives more."""
_SQUARES = {9: 3, 36: 6}
"""Length of an array → rows of the square matrix that it is: the covariances of ROS."""

_TEXT_SLICE = 8000
"""Characters of a long text that a hint asks for at once: with its quotes escaped they fit into one answer."""
_SCAN = "sensor_msgs/msg/LaserScan"
"""In a scan the nearest point matters: the summary of its ranges includes the angle of the smallest range, in radians.
"""
_ANGLE_DIGITS = 4
"""Decimals of an angle in rad (0.006°): no scanner is as exact."""

_FLOAT32 = Struct("<f")
_ABSENT = object()
"""Marks a field that a message lacks, as JSON messages may."""
# Limits to try one after the other if a message is too long: first shorter arrays and strings, each about a quarter of
# the one before, then fewer levels.
_ARRAY_STEPS = (16, 4, 0)
_STRING_STEPS = (256, 64)
_DEPTH_STEPS = (4, 3, 2, 1, 0)
_UNLIMITED = 2**31


@dataclass(frozen=True, slots=True)
class RenderOptions:
    """Limits and form of the JSON.

    Arrays longer than `max_array` and strings longer than `max_string` (characters) become summaries. If the JSON text
    is still longer than `max_bytes`, both are lowered step by step, then deeply nested messages are omitted. `fields`
    selects paths; a selected slice or string is shown in full if it fits. `exact` shows every value in full, whatever
    the size, and in its plainest form: floating-point numbers as such, arrays as lists. `native` returns Python values
    for a program instead of their JSON form: infinities and large integers as numbers, many bytes as `bytes`. With
    `native`, `hold` may keep a large array and return a placeholder for it, or None to decline.
    """

    max_array: int = 64
    max_string: int = 2048
    max_bytes: int = 32_768
    fields: Sequence[str] | None = None
    exact: bool = False
    native: bool = False
    hold: Callable[[FieldType, NDArray[Any]], Any] | None = None


@dataclass(frozen=True, slots=True)
class Rendered:
    """A message as JSON: its fields, or path → value if fields were selected.

    `truncated` has the paths of summarised values (`poses[*].name` is any index), each with the field to select for
    more: a string or message by its name, a list by a slice. `bytes` is the length of the compact JSON text, with
    hidden characters escaped.
    """

    value: dict[str, Any]
    truncated: Mapping[str, str]
    bytes: int


class _Limits(NamedTuple):
    """Limits of one rendering; `slice` is for elements selected by a path, `text` for selected characters."""

    array: int
    string: int
    depth: int
    slice: int
    text: int


def render(definitions: Definitions, type_name: str, message: object, *, options: RenderOptions) -> Rendered:
    """Convert a message to JSON within the bounds.

    NaN and the infinities are the strings `"nan"`, `"inf"`, `"-inf"`; integers beyond 2^53 are decimal strings; bytes
    are a list up to 64, else base64; diagonal matrices are objects with `$diagonal`. `check` converts all of these back
    to an equal message.

    Raises:
        BadValue: for a path in `fields` that does not exist, or an index beyond the list.
    """
    selections = parse_fields(definitions, type_name, options.fields) if options.fields else None
    result = Rendered({}, {}, 2)
    for limits in _attempts(options):
        result = _Render(definitions, limits, options).whole(type_name, message, selections)
        if options.exact or options.native or result.bytes <= options.max_bytes:
            break
    return result


def example_of(definitions: Definitions, type_name: str) -> dict[str, Any]:
    """Return a message as JSON with every field at its default, else zero, to fill in; `check` accepts it unchanged."""
    return render(definitions, type_name, check(definitions, type_name, {}), options=RenderOptions(exact=True)).value


def _attempts(options: RenderOptions) -> Iterator[_Limits]:
    """Yield limits to try, each tighter than the limit before."""
    if options.exact or options.native:
        yield _Limits(_UNLIMITED, _UNLIMITED, _UNLIMITED, _UNLIMITED, _UNLIMITED)
        return
    most = max(options.max_bytes // 2, 1)  # an element takes at least two characters
    array, string = min(max(options.max_array, 0), most), min(max(options.max_string, 0), most)
    yield _Limits(array, string, _UNLIMITED, most, 2 * most)
    text = most
    for lower, shorter in zip(_ARRAY_STEPS, (*_STRING_STEPS, _STRING_STEPS[-1]), strict=True):
        array, string = min(array, lower), min(string, shorter)
        yield _Limits(array, string, _UNLIMITED, array, text)
        text = string
    for depth in _DEPTH_STEPS:
        yield _Limits(array, string, depth, array, string)


class _Render:
    def __init__(self, definitions: Definitions, limits: _Limits, options: RenderOptions) -> None:
        self._definitions = definitions
        self._exact = options.exact
        self._native = options.native
        self._hold = options.hold
        self._limits = limits
        self._truncated: dict[str, str] = {}

    def whole(self, type_name: str, message: object, selections: Sequence[FieldPath] | None) -> Rendered:
        if selections is None:
            value = self._message(type_name, message, "", self._limits.depth)
        else:
            value = {chosen.path: self._follow(chosen.path, chosen.steps, message) for chosen in selections}
        if self._native:  # the value does not become JSON
            return Rendered(value, {}, 0)
        _, text = visible_json(value)
        return Rendered(value, self._truncated, len(text.encode()))

    def _message(self, type_name: str, message: object, path: str, depth: int) -> dict[str, Any]:
        if depth <= 0:
            self._cut(path)
            return {SUMMARY: type_name}
        result: dict[str, Any] = {}
        for field in self._definitions.structure(type_name).fields:
            below = f"{path}.{field.name}" if path else field.name
            value = getattr(message, attribute(field.name), _ABSENT)
            if value is not _ABSENT:
                result[field.name] = self._value(field.type, value, below, depth - 1)
        if type_name == _SCAN:
            _add_angle(result)
        return result

    def _value(self, field_type: FieldType, value: Any, path: str, depth: int) -> Any:
        if value is None:  # null in a JSON message
            return None
        if field_type.arity != "single":
            return self._several(field_type, value, path, depth, self._limits.array)
        if field_type.is_message:
            return self._message(field_type.base, value, path, depth)
        if field_type.base in TEXTS:
            return self._text(value, path, self._limits.string)
        if self._native:
            return _short(value) if field_type.base == "float32" and math.isfinite(value) else value
        return _json_number(field_type.base, value, exact=self._exact)

    def _several(self, field_type: FieldType, values: Any, path: str, depth: int, most: int) -> Any:
        if field_type.is_message or field_type.base in TEXTS:
            return self._list(field_type, values, path, depth, most)
        if self._native:
            held = self._hold(field_type, values) if self._hold else None
            return _native_numbers(field_type, values) if held is None else held
        if len(values) <= most:
            diagonal = None if self._exact or not is_covariance(path) else _diagonal(field_type, values)
            if diagonal is not None:
                return {DIAGONAL: _json_numbers(field_type, diagonal)}
            return _json_numbers(field_type, values, exact=self._exact)
        self._cut(path, slice_of=path)
        return _numbers_summary(field_type, values, min(most, _MOST_FIRST))

    def _list(self, field_type: FieldType, values: list[Any], path: str, depth: int, most: int) -> Any:
        element = field_type.element
        first = [self._value(element, value, f"{path}[*]", depth) for value in values[:most]]
        if len(values) <= most:
            return first
        self._cut(path, slice_of=path)
        return _list_summary(field_type, len(values), first)

    def _text(self, text: str, path: str, most: int, whole: str = "", start: int = 0) -> Any:
        """A text; as a part of another text (its path is `whole`), it begins at `start` there."""
        if len(text) <= most and (text.isascii() or is_unicode(text)):
            return text
        self._cut(path)
        if len(text) > most:
            if len(text) > _TEXT_SLICE and "[" not in (whole or path):
                shown = start + most
                self._truncated[path] = f"{whole or path}[{shown}:{shown + _TEXT_SLICE}]"
            return {SUMMARY: "string", "length": len(text), "first": escaped_bytes(text[:most])}
        # JSON cannot represent it exactly: it is not UTF-8, or has a lone surrogate.
        return {SUMMARY: "string", "not_utf8": escaped_bytes(text)}

    def _follow(self, path: str, steps: tuple[Step, ...], value: Any) -> Any:
        """Return the value at a selected path; beyond a slice, a list with the rest of the path in each element."""
        step, rest = steps[0], steps[1:]
        field_type, value = step.field.type, getattr(value, attribute(step.field.name), None)
        if value is None:  # in a JSON message: null, or the field is absent
            return None
        if isinstance(step.pick, int):
            field_type, value = field_type.element, element_at(value, step.pick, path)
        elif isinstance(step.pick, slice) and field_type.arity == "single":  # characters of a text
            start, end, stride = step.pick.indices(len(value))
            whole = path.rpartition("[")[0] if stride == 1 else ""
            return self._text(value[start:end:stride], path, self._limits.text, whole, start)
        elif step.pick is not None:
            value = several_of(value, step.pick)
            if rest:
                first = [self._follow(path, rest, element) for element in value[: self._limits.slice]]
                if len(first) == len(value):
                    return first
                self._cut(path)
                return _list_summary(FieldType(rest[-1].field.type.base, "sequence"), len(value), first)
            part = FieldType(field_type.base, "sequence", 0, field_type.text_bound)
            return self._several(part, value, path, self._limits.depth, self._limits.slice)
        if rest:
            return self._follow(path, rest, value)
        if field_type.arity == "single" and field_type.base in TEXTS:
            return self._text(value, path, self._limits.text)
        return self._value(field_type, value, path, self._limits.depth)

    def _cut(self, path: str, slice_of: str = "") -> None:
        self._truncated[path] = f"{slice_of}{FIRST_ELEMENTS}" if slice_of and "[" not in slice_of else path


# ── numbers and texts, exactly or as a summary ────────────────────────────────────────────────────────────────────


def _json_number(base: str, value: Any, *, exact: bool = False) -> Any:
    """Convert one boolean or number to JSON: non-finite as a string, a float32 with the fewest digits that identify it.

    Unless `exact`, a floating-point number without a fraction becomes an integer, 0 for 0.0: JSON has one kind of
    number.
    """
    if base in FLOATS:
        if not math.isfinite(value):
            return not_finite_text(value)
        short = _short(value) if base == "float32" else value
        is_whole = short.is_integer() and abs(short) <= EXACT_INTEGER and (short or math.copysign(1, short) > 0)
        return int(short) if is_whole and not exact else short
    return str(value) if base in ("int64", "uint64") and abs(value) > EXACT_INTEGER else value


def _json_numbers(field_type: FieldType, values: NDArray[Any], *, exact: bool = False) -> list[Any] | str:
    """Convert a whole array exactly."""
    if field_type.base in OCTETS and len(values) > _BYTES_AS_LIST:
        return base64.b64encode(values.tobytes()).decode()
    plain: list[Any] = values.tolist()
    if field_type.base == "float32" or field_type.base.endswith("64"):
        return [_json_number(field_type.base, value, exact=exact) for value in plain]
    return plain


def _native_numbers(field_type: FieldType, values: NDArray[Any]) -> list[Any] | bytes:
    """Convert an array to Python numbers.

    Seven digits identify a float32 well enough, at a third of the cost of exactness.
    """
    if field_type.base in OCTETS and len(values) > _BYTES_AS_LIST:
        return values.tobytes()
    plain: list[Any] = values.tolist()
    return [float(f"{value:.7g}") for value in plain] if field_type.base == "float32" else plain


def _diagonal(field_type: FieldType, values: NDArray[Any]) -> NDArray[Any] | None:
    """Return the diagonal of a fixed-size square matrix that is 0.0 off the diagonal; None for any other array."""
    rows = _SQUARES.get(len(values)) if field_type.arity == "array" and field_type.base in FLOATS else None
    if not rows:
        return None
    beside = values[np.arange(len(values)) % (rows + 1) != 0]
    return None if beside.any() or np.signbit(beside).any() else values[:: rows + 1]


def _numbers_summary(field_type: FieldType, values: NDArray[Any], first: int) -> dict[str, Any]:
    """Summarise an array: its length, first values and statistics of its finite values; for bytes only the length."""
    summary: dict[str, Any] = {SUMMARY: str(field_type), "length": len(values)}
    if field_type.base in OCTETS:
        return summary
    summary["first"] = _json_numbers(field_type, values[:first])
    summary["omitted"] = len(values) - len(values[:first])
    if field_type.base == "bool":
        return {**summary, "true": int(np.count_nonzero(values))}
    return {**summary, **_statistics(field_type.base, values)}


def _list_summary(field_type: FieldType, length: int, first: Sequence[Any]) -> dict[str, Any]:
    """Summarise a list of messages or strings: its length and first elements."""
    return {SUMMARY: str(field_type), "length": length, "first": first, "omitted": length - len(first)}


def _add_angle(scan: dict[str, Any]) -> None:
    """Add the angle of the smallest range to a scan's summary of ranges, if the definition has the usual fields."""
    ranges: Any = scan.get("ranges") or ()
    start, last, step = (scan.get(name) for name in ("angle_min", "angle_max", "angle_increment"))
    if not (isinstance(start, (int, float)) and isinstance(step, (int, float)) and "min_at" in ranges):
        return
    last = last if isinstance(last, (int, float)) else 0.0
    told = SimpleNamespace(angle_min=start, angle_max=last, angle_increment=step, ranges=range(ranges["length"]))
    if not no_bearings(told):
        ranges["min_at_angle"] = _json_number("float64", round(float(start + ranges["min_at"] * step), _ANGLE_DIGITS))


def _statistics(base: str, values: NDArray[Any]) -> dict[str, Any]:
    """Return statistics of the finite values; `min_at` is the index of the smallest value in the whole array."""
    indices = np.flatnonzero(np.isfinite(values)) if base in FLOATS else np.arange(len(values))
    finite = values[indices]
    result: dict[str, Any] = {"min": None, "max": None, "mean": None}
    if len(finite):
        with np.errstate(over="ignore"):
            mean = float(f"{finite.mean(dtype=np.float64):.6g}")
        least = int(finite.argmin())
        result["min"], result["min_at"] = _json_number(base, finite[least].item()), int(indices[least])
        result["max"] = _json_number(base, finite.max().item())
        result["mean"] = mean if math.isfinite(mean) else not_finite_text(mean)
    if len(finite) < len(values):
        nan = int(np.count_nonzero(np.isnan(values)))
        result |= {"nan": nan, "inf": len(values) - len(finite) - nan}
    return result


def _short(value: float) -> float:
    """Return the shortest decimal that rounds to the same float32 as `value`, which is a float32."""
    for digits in ("%.7g", "%.8g", "%.9g"):
        short = float(digits % value)
        try:
            if _FLOAT32.unpack(_FLOAT32.pack(short))[0] == value:
                return short
        except OverflowError:
            continue
    return value
