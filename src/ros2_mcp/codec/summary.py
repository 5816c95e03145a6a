"""Numbers and texts as JSON: exactly, or as a summary where they are too long.

A summary is an object with the key `$summary`, which tells the type of what it stands for.
No field can have that name, so `check` never mistakes a summary for a value.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Sequence
from struct import Struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ros2_mcp.codec.scalars import EXACT, SUMMARY
from ros2_mcp.codec.text import escaped_bytes
from ros2_mcp.model.interfaces import OCTETS, FieldType

BYTES_AS_LIST = 64
"""Bytes up to this many are shown as a list, more as base64."""

_FLOAT32 = Struct("<f")


def json_number(base: str, value: Any) -> Any:
    """One boolean or number: not finite as text, a float32 with as few digits as tell it from all others."""
    if base == "float64":
        return value if math.isfinite(value) else _not_finite(value)
    if base == "float32":
        return _short(value) if math.isfinite(value) else _not_finite(value)
    if base.endswith("64") and abs(value) > EXACT:
        return str(value)
    return value


def json_numbers(field_type: FieldType, values: NDArray[Any]) -> list[Any] | str:
    """A whole array, exactly."""
    if field_type.base in OCTETS and len(values) > BYTES_AS_LIST:
        return base64.b64encode(values.tobytes()).decode()
    plain: list[Any] = values.tolist()
    if field_type.base == "float32" or field_type.base.endswith("64"):
        return [json_number(field_type.base, value) for value in plain]
    return plain


def numbers_summary(field_type: FieldType, values: NDArray[Any], first: int) -> dict[str, Any]:
    """An array as its length, first values and statistics over its finite values; bytes as their number only."""
    summary: dict[str, Any] = {SUMMARY: str(field_type), "length": len(values)}
    if field_type.base in OCTETS:
        return summary
    summary["first"] = json_numbers(field_type, values[:first])
    summary["omitted"] = len(values) - len(values[:first])
    if field_type.base == "bool":
        return {**summary, "true": int(np.count_nonzero(values))}
    return {**summary, **_statistics(field_type.base, values)}


def list_summary(field_type: FieldType, length: int, first: Sequence[Any]) -> dict[str, Any]:
    """A list of messages or texts as its length and its first elements."""
    return {SUMMARY: str(field_type), "length": length, "first": first, "omitted": length - len(first)}


def text_summary(text: str, first: int) -> dict[str, Any]:
    """A text as its length in characters and its beginning."""
    return {SUMMARY: "string", "length": len(text), "first": escaped_bytes(text[:first])}


def text_problem(text: str) -> dict[str, Any]:
    """A text that JSON cannot carry exactly, because it is not UTF-8 (or has half a character)."""
    return {SUMMARY: "string", "not_utf8": escaped_bytes(text)}


def _statistics(base: str, values: NDArray[Any]) -> dict[str, Any]:
    if base not in ("float32", "float64"):
        return _extremes(base, values)
    finite = values[np.isfinite(values)]
    result = _extremes(base, finite) if len(finite) else {"min": None, "max": None, "mean": None}
    if len(finite) < len(values):
        nan = int(np.count_nonzero(np.isnan(values)))
        result |= {"nan": nan, "inf": len(values) - len(finite) - nan}
    return result


def _extremes(base: str, values: NDArray[Any]) -> dict[str, Any]:
    low, high = values.min().item(), values.max().item()
    with np.errstate(over="ignore"):
        mean = float(f"{values.mean(dtype=np.float64):.6g}")
    return {
        "min": json_number(base, low),
        "max": json_number(base, high),
        "mean": mean if math.isfinite(mean) else _not_finite(mean),
    }


def _not_finite(value: float) -> str:
    if math.isnan(value):
        return "nan"
    return "inf" if value > 0 else "-inf"


def _short(value: float) -> float:
    """The shortest decimal that is read back as the same float32; `value` is one."""
    for digits in ("%.7g", "%.8g", "%.9g"):
        short = float(digits % value)
        try:
            if _FLOAT32.unpack(_FLOAT32.pack(short))[0] == value:
                return short
        except OverflowError:
            continue
    return value
