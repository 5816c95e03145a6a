"""Convert parameter values exactly between JSON and rcl_interfaces/msg/ParameterValue."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, cast

from ros2_mcp.model.errors import BadValue
from ros2_mcp.model.text import excerpt
from ros2_mcp.model.values import EXACT_INTEGER, not_finite_number

TYPES = (
    "not_set",
    "bool",
    "integer",
    "double",
    "string",
    "byte_array",
    "bool_array",
    "integer_array",
    "double_array",
    "string_array",
)
"""Names of the types by their codes in rcl_interfaces/msg/ParameterType."""

_FIELDS = ("", *(f"{name}_value" for name in TYPES[1:]))
_INTEGER = re.compile(r"-?[0-9]{1,19}")


def type_name(code: int) -> str:
    """Return the name of a parameter type's code."""
    return TYPES[code] if 0 <= code < len(TYPES) else f"unknown({code})"


def value_of(message: Mapping[str, Any]) -> Any:
    """Return the plain value of a ParameterValue; None if it is not set."""
    code = int(message["type"])
    return message[_FIELDS[code]] if 0 < code < len(_FIELDS) else None


def as_message(path: str, value: Any, declared: str) -> dict[str, Any]:
    """Return the ParameterValue of a JSON value for a parameter declared with that type.

    An integer is accepted as a double (1 → 1.0) and a whole double as an integer (3.0 → 3); a string only for values
    that are shown as strings: not finite, or an integer beyond 2^53. Nothing else is converted.

    Raises:
        BadValue: if the value is not of the declared type.
    """
    kind = _kind(path, value, declared)
    converted = _converted(path, value, kind)
    code = TYPES.index(kind)
    return {"type": code, _FIELDS[code]: converted} if code else {"type": 0}


def _kind(path: str, value: Any, declared: str) -> str:
    if declared not in ("not_set", "dynamic"):
        return declared
    if value is None:
        return "not_set"
    if isinstance(value, list):
        items = cast("list[Any]", value)
        kinds = {_kind(f"{path}[{index}]", item, "dynamic") for index, item in enumerate(items)}
        if kinds == {"integer", "double"}:
            return "double_array"
        if len(kinds) != 1 or f"{min(kinds)}_array" not in TYPES:
            raise BadValue(path, "an array needs at least one element, all of one type: bool, number or text.")
        return f"{kinds.pop()}_array"
    kinds_by_type = {bool: "bool", int: "integer", float: "double", str: "string"}
    if type(value) not in kinds_by_type:
        raise BadValue(
            path,
            f"{excerpt(value)} is not a parameter value.",
            "Give a bool, number, text, or an array of one of them.",
        )
    return kinds_by_type[type(value)]


def _converted(path: str, value: Any, kind: str) -> Any:
    if kind == "not_set":
        return None
    if kind == "byte_array" and isinstance(value, str):
        return value
    if kind.endswith("_array"):
        if not isinstance(value, list):
            raise BadValue(path, f"{excerpt(value)} is not an array.", f"The parameter is declared as {kind}.")
        element = {"byte_array": "integer"}.get(kind, kind.removesuffix("_array"))
        items = cast("list[Any]", value)
        converted = [_scalar(f"{path}[{index}]", item, element, kind) for index, item in enumerate(items)]
        for index, item in enumerate(converted if kind == "byte_array" else ()):
            if not 0 <= item <= 255:
                raise BadValue(f"{path}[{index}]", f"{excerpt(item)} is not a byte.", "Give 0 to 255.")
        return converted
    return _scalar(path, value, kind, kind)


def _scalar(path: str, value: Any, kind: str, declared: str) -> Any:
    """Convert a scalar, or an element of a list; `declared` is the type of its parameter."""
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if kind == "bool" and isinstance(value, bool):
        return value
    if kind == "string" and isinstance(value, str):
        return value
    if kind == "double" and (is_number or (isinstance(value, str) and not_finite_number(value) is not None)):
        return value
    whole = _whole(value) if kind == "integer" else None
    if whole is None:
        hint = f"The parameter is declared as {declared}."
        if declared == "byte_array":
            hint += " rclpy takes an empty list that is declared without a type for one."
        raise BadValue(path, f"{excerpt(value)} is not of type {kind}.", hint)
    if not -(2**63) <= whole < 2**63:
        raise BadValue(path, f"{excerpt(value)} does not fit an integer of 64 bits.")
    return whole


def _whole(value: Any) -> int | None:
    """Return the integer to which the value is exactly equal; None if there is none."""
    if isinstance(value, str) and _INTEGER.fullmatch(value) and abs(int(value)) > EXACT_INTEGER:
        return int(value)
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return None
    return int(value) if isinstance(value, int) or value.is_integer() else None
