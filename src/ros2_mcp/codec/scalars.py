"""Single JSON values and lists of numbers → exactly the values that fit a primitive type."""

from __future__ import annotations

import base64
import binascii
import math
import re
from collections.abc import Mapping, Sequence
from struct import Struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ros2_mcp.codec.text import excerpt, is_unicode
from ros2_mcp.model.errors import BadValue
from ros2_mcp.model.interfaces import FLOATS, INTEGERS, FieldType

SUMMARY = "$summary"
"""The key of an object that stands for a value too long to show. No field can have this name."""
NOT_FINITE = {"nan": math.nan, "inf": math.inf, "-inf": -math.inf}
EXACT = 2**53
"""Beyond this, JSON readers that keep numbers as float64 lose digits of integers."""

_FLOAT32 = Struct("<f")
_DECIMAL = re.compile(r"-?\d{1,20}", re.ASCII)
_DTYPES: Mapping[str, type[np.generic]] = {
    "bool": np.bool_,
    "byte": np.uint8,
    "char": np.uint8,
    **{name: getattr(np, name) for name in (*FLOATS, *INTEGERS) if name not in ("byte", "char")},
}
_LIMITS = {base: f"{low} to {high}" for base, (low, high) in INTEGERS.items()}


def zeros(base: str, length: int) -> NDArray[Any]:
    """An array of zeros of a numeric type."""
    return np.zeros(length, _DTYPES[base])


def scalar(field_type: FieldType, value: object, path: str) -> bool | int | float | str:
    """The value as exactly what the primitive type holds.

    Raises:
        BadValue: naming `path`, if it does not fit without loss.
    """
    if is_summary(value):
        raise summary_error(path)
    if field_type.base == "bool":
        return _boolean(value, path)
    if field_type.base in INTEGERS:
        return _integer(field_type.base, value, path)
    if field_type.base in FLOATS:
        return _float(field_type.base, value, path)
    return _text(field_type, value, path)


def numbers(field_type: FieldType, values: Sequence[object], path: str) -> NDArray[Any]:
    """A list as an array of the numeric type, or of booleans; raises `BadValue` as `scalar` does."""
    kinds = set(map(type, values))
    if field_type.base in FLOATS and kinds <= {float}:
        return _floats(field_type, values, path)
    if field_type.base in INTEGERS and kinds == {int} and _all_in_range(field_type.base, values):
        return np.array(values, _DTYPES[field_type.base])
    return _one_by_one(field_type, values, path)


def _floats(field_type: FieldType, values: Sequence[Any], path: str) -> NDArray[Any]:
    exact = np.array(values, np.float64)
    if field_type.base == "float64":
        return exact
    with np.errstate(over="ignore"):
        rounded = exact.astype(np.float32)
    if np.array_equal(np.isinf(rounded), np.isinf(exact)):
        return rounded
    return _one_by_one(field_type, values, path)


def _one_by_one(field_type: FieldType, values: Sequence[object], path: str) -> NDArray[Any]:
    element, dtype = field_type.element, _DTYPES[field_type.base]
    return np.array([scalar(element, value, f"{path}[{index}]") for index, value in enumerate(values)], dtype)


def octets(text: str, path: str) -> NDArray[np.uint8]:
    """The bytes that a base64 string stands for."""
    try:
        return np.frombuffer(base64.b64decode(text, validate=True), np.uint8)
    except (binascii.Error, ValueError) as error:
        raise BadValue(
            path, f"{excerpt(text)} is not base64.", "Give bytes as a list of 0 to 255 or as base64."
        ) from error


def is_summary(value: object) -> bool:
    """Whether it is a summary that `render` made in the place of a value."""
    return isinstance(value, Mapping) and SUMMARY in value


def summary_error(path: str) -> BadValue:
    """The refusal of a summary in the place of a value."""
    return BadValue(
        path,
        "this is a summary of a value that was too long to show, not the value itself.",
        "Read it in full (fields, max_array), or leave the field out to send its default.",
    )


def _all_in_range(base: str, values: Sequence[Any]) -> bool:
    low, high = INTEGERS[base]
    return low <= min(values) and max(values) <= high


def _wrong(path: str, value: object, expected: str, hint: str = "") -> BadValue:
    return BadValue(path, f"{excerpt(value)} given, {expected} expected.", hint)


def _boolean(value: object, path: str) -> bool:
    if isinstance(value, bool):
        return value
    raise _wrong(path, value, "bool", "Write true or false, without quotes.")


def _integer(base: str, value: object, path: str) -> int:
    number = _as_integer(base, value, path)
    low, high = INTEGERS[base]
    if not low <= number <= high:
        raise _wrong(path, value, f"{base}, {_LIMITS[base]},")
    return number


def _as_integer(base: str, value: object, path: str) -> int:
    if isinstance(value, int) and not isinstance(value, bool):
        return value
    if isinstance(value, float) and value.is_integer():
        if abs(value) > EXACT:
            raise _wrong(
                path, value, base, "Integers beyond 2^53 are exact only as strings: write the digits in quotes."
            )
        return int(value)
    if isinstance(value, str) and base.endswith("64") and _DECIMAL.fullmatch(value):
        return int(value)
    hint = "Write the number without quotes." if isinstance(value, str) else ""
    raise _wrong(path, value, base, "It would lose its fraction: round it." if isinstance(value, float) else hint)


def _float(base: str, value: object, path: str) -> float:
    number = _as_float(base, value, path)
    if base == "float32":
        try:
            _FLOAT32.pack(number)
        except OverflowError as error:
            raise _wrong(path, value, "float32, -3.4e38 to 3.4e38,") from error
    return number


def _as_float(base: str, value: object, path: str) -> float:
    if isinstance(value, float):
        return value
    if isinstance(value, int) and not isinstance(value, bool):
        return _exact_float(base, value, path)
    if isinstance(value, str):
        if value in NOT_FINITE:
            return NOT_FINITE[value]
        raise _wrong(path, value, base, 'Write the number without quotes; only "nan", "inf" and "-inf" are strings.')
    raise _wrong(path, value, base)


def _exact_float(base: str, value: int, path: str) -> float:
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if number != value:
        raise _wrong(
            path, value, base, "This integer is not exactly a floating-point number: write it as one, such as 1e17."
        )
    return number


def _text(field_type: FieldType, value: object, path: str) -> str:
    if not isinstance(value, str):
        raise _wrong(path, value, str(field_type), "Write it in quotes." if isinstance(value, (int, float)) else "")
    if not is_unicode(value):
        raise BadValue(path, f"{excerpt(value)} has half a character (a lone surrogate), which cannot be encoded.")
    length = len(value.encode()) if field_type.base == "string" else len(value.encode("utf-16-le")) // 2
    if field_type.text_bound and length > field_type.text_bound:
        unit = "bytes" if field_type.base == "string" else "characters"
        raise BadValue(path, f"a text of {length} {unit} given, {field_type} expected.", "Shorten it.")
    return value
