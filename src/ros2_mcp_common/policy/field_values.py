"""Reading fields of JSON objects and of messages decoded by rclpy alike, by paths such as `points[].positions[]`.

A field that cannot be read raises `Unfit`: it is missing, or a string where a number is expected.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, cast

from ros2_mcp_common.wire.limits import MAX_JUDGED_ELEMENTS

_FLOAT32 = struct.Struct("<f")
_LARGE_INTEGER = re.compile(r"-?[0-9]{16,20}")


class Unfit(Exception):
    """Raised if a value has no such field, or the field cannot be judged."""


def fields_of(value: Any) -> Sequence[str]:
    """Return the names of the fields of a JSON object or a message; empty for any other value."""
    if isinstance(value, Mapping):
        return list(cast("Mapping[str, Any]", value))
    return list(value.get_fields_and_field_types()) if hasattr(value, "get_fields_and_field_types") else ()


def get(value: Any, name: str) -> Any:
    """Return one field. Raise `Unfit` if there is none."""
    if name not in fields_of(value):
        raise Unfit(f"there is no field {name}, which has a limit")
    return cast("Mapping[str, Any]", value)[name] if isinstance(value, Mapping) else getattr(value, name)


def at(value: Any, path: str) -> Iterator[tuple[str, Any]]:
    """Yield every field at a path with its own path, in which each `[]` has its index: `points[3].velocities[0]`."""
    return ((shown, found) for shown, found, _ in with_frame_ids(value, path))


def with_frame_ids(value: Any, path: str) -> Iterator[tuple[str, Any, str]]:
    """Yield the same as `at`, each with the frame in the nearest header above the field ("" if there is none)."""
    steps = steps_of(value, path)
    found = [("", value, frame_id_of(value))]
    for step in steps:
        found = [after for before in found for after in _after(*before, step)]
    return iter(found)


def _after(shown: str, value: Any, frame_id: str, step: str) -> Iterator[tuple[str, Any, str]]:
    """Follow one step of a path (a field, or `[]`): yield path, value and frame id of each field that it reaches."""
    if step == "[]":
        if not is_list(value):
            raise Unfit(f"{shown} is not a list, but its elements have a limit")
        for place, element in _elements(value, shown):
            yield f"{shown}[{place}]", element, frame_id_of(element) or frame_id
        return
    below = get(value, step)
    yield f"{shown}.{step}".lstrip("."), _meant(value, step, below), frame_id_of(below) or frame_id


def steps_of(value: Any, path: str) -> list[str]:
    """Return the steps of a path from this value: `["points", "[]", "velocities"]`, with the
    omitted field of a stamped type.
    """
    steps = [step for step in path.replace("[]", ".[]").split(".") if step]
    present = fields_of(value)
    if steps and steps[0] not in present and len(present) == 2 and "header" in present:
        steps.insert(0, next(name for name in present if name != "header"))
    return steps


def frame_id_of(value: Any) -> str:
    """Return the `header.frame_id` of a value; "" if it has none."""
    if "header" not in fields_of(value):
        return ""
    header = get(value, "header")
    return str(get(header, "frame_id")) if "frame_id" in fields_of(header) else ""


def is_list(value: Any) -> bool:
    """Return whether a value is a list or an array of rclpy. Strings and bytes are not lists."""
    return hasattr(value, "__len__") and hasattr(value, "__getitem__") and not isinstance(value, (str, bytes, Mapping))


def numbers(value: Any, path: str) -> Iterator[tuple[str, float]]:
    """Yield every number at or below a path with its own path. Raise `Unfit` for any other value."""
    if names := fields_of(value):
        for name in names:
            yield from numbers(_meant(value, name, get(value, name)), f"{path}.{name}".lstrip("."))
    elif is_list(value):
        for place, element in _elements(value, path):
            yield from numbers(element, f"{path}[{place}]")
    else:
        yield path, number_of(value, path)


def _elements(value: Any, path: str) -> Iterator[tuple[int, Any]]:
    """Yield the elements of a list with their indices. Raise `Unfit` if there are too many to be judged in time."""
    if len(value) > MAX_JUDGED_ELEMENTS:
        raise Unfit(f"{path} has {len(value)} elements, more than the {MAX_JUDGED_ELEMENTS} that are judged")
    return cast("Iterator[tuple[int, Any]]", enumerate(value))


def number_at(value: Any, name: str, path: str) -> float:
    """Return one field as a number; `path` is its name in errors."""
    return number_of(_meant(value, name, get(value, name)), path)


def number_of(value: Any, path: str) -> float:
    """Return a value as a number. Raise `Unfit` if it is not a number.

    Strings that the server writes for numbers are accepted: large integers, and "nan", "inf" and
    "-inf", which all give NaN.
    """
    if isinstance(value, str) and _LARGE_INTEGER.fullmatch(value):
        return float(int(value))
    if isinstance(value, str) and value in ("nan", "inf", "-inf"):
        return math.nan
    if isinstance(value, (bool, str)) or not hasattr(value, "__float__"):
        raise Unfit(f"{path} is not a number, but has a limit")
    return float(value)


def _meant(message: Any, name: str, value: Any) -> Any:
    """Return a float32 of a message as the decimal number that was meant: 0.2, not 0.200000003: the latter exceeds a
    limit of 0.2.
    """
    if not isinstance(value, float) or isinstance(message, Mapping):
        return value
    if message.get_fields_and_field_types().get(name) != "float" or not math.isfinite(value):
        return value
    for digits in range(6, 10):  # nine digits distinguish all float32 values
        meant = float(f"{value:.{digits}g}")
        if abs(meant) < 3.5e38 and _FLOAT32.unpack(_FLOAT32.pack(meant))[0] == value:
            return meant
    return value
