"""Detect changes of a message by value: exact, or beyond a tolerance given for a field."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from ros2_mcp.model.errors import BadValue
from ros2_mcp.model.interfaces import HEADER
from ros2_mcp.values.cdr import Codec
from ros2_mcp.values.select import numeric_fields, parse_fields, value_at
from ros2_mcp.values.store import attribute

EVERY = "*"
_Blank = Callable[[Any], None]


class ChangeDetector:
    """Compares each message with the last message that was a change.

    The stamps of headers are ignored. A field with a tolerance has changed if it differs by more than the tolerance, or
    if just one of the two values is NaN; any other field has changed if it differs at all. The tolerance of `*` applies
    to every number outside of arrays that has none of its own.

    Raises:
        BadValue: for a tolerance that is negative, or for a field that does not exist, is no number, or is in an array.
    """

    def __init__(self, codec: Codec, type_name: str, tolerances: Mapping[str, float]) -> None:
        self._codec = codec
        self._type = type_name
        self._tolerances = _checked(codec, type_name, tolerances)
        self._blank = _stamps_blank(codec, type_name)
        self._last: tuple[bytes, list[Any]] | None = None

    def is_change(self, data: bytes) -> bool:
        """Return whether this message (CDR) is the first, or differs from the last that was a change.

        Raises:
            BadData: if it is not a message of the type.
        """
        # Fields with a tolerance are compared one by one and set to zero; all else, with the lengths of arrays, as
        # bytes.
        message: Any = self._codec.decode(self._type, data)
        values = [value_at(message, path) for path in self._tolerances]
        for path, value in zip(self._tolerances, values, strict=True):
            above, _, name = path.rpartition(".")
            zero = np.zeros_like(cast("NDArray[Any]", value)) if isinstance(value, np.ndarray) else type(value)()
            setattr(value_at(message, above) if above else message, attribute(name), zero)
        for blank in self._blank:
            blank(message)
        rest = self._codec.encode(self._type, message)
        former, former_values = self._last or (None, values)
        if rest == former and not any(map(_differ, values, former_values, self._tolerances.values())):
            return False
        self._last = rest, values
        return True


def _differ(value: Any, other: Any, tolerance: float) -> bool:
    ours, theirs = np.asarray(value), np.asarray(other)
    if ours.dtype.kind in "iu":
        ours, theirs = ours.astype(object), theirs.astype(object)  # exact: no overflow, no rounding of 64 bits
        return bool(np.any(np.abs(ours - theirs) > tolerance))
    with np.errstate(invalid="ignore"):
        near = np.abs(ours.astype(float) - theirs.astype(float)) <= tolerance
    same = (ours == theirs) | (np.isnan(ours) & np.isnan(theirs))
    return not bool(np.all(near | same))


def _checked(codec: Codec, type_name: str, tolerances: Mapping[str, float]) -> dict[str, float]:
    """Return the tolerance of each field; that of `*` goes to every number without a tolerance of its own."""
    chosen = {path: tolerance for path, tolerance in tolerances.items() if path != EVERY}
    for path, tolerance in tolerances.items():
        if not tolerance >= 0:
            raise BadValue(path, f"{tolerance} is not a tolerance.", "Give a number that is not negative.")
    for path in chosen:
        steps = parse_fields(codec.definitions, type_name, [path])[0].steps
        last = steps[-1].field
        if "[" in path or any(step.field.type.arity != "single" for step in steps[:-1]):
            raise BadValue(path, "a tolerance cannot be given for elements.", "Give the whole field.")
        if not last.type.is_number:
            raise BadValue(path, f"{last.type} has no numbers to compare.", "Give a field made of numbers.")
    numbers = numeric_fields(codec.definitions, type_name) if EVERY in tolerances else []
    stamps = tuple(f"{path}." for path in _stamp_paths(codec, type_name, ""))
    return {path: tolerances[EVERY] for path in numbers if not path.startswith(stamps)} | chosen


def _stamp_paths(codec: Codec, type_name: str, path: str) -> list[str]:
    """Return the paths of the stamps of headers that are not in lists."""
    found: list[str] = []
    for field in codec.definitions.structure(type_name).fields:
        here = f"{path}.{field.name}".removeprefix(".")
        if field.type.arity != "single" or not field.type.is_message:
            continue
        found += [f"{here}.stamp"] if field.type.base == HEADER else _stamp_paths(codec, field.type.base, here)
    return found


def _stamps_blank(codec: Codec, type_name: str) -> list[_Blank]:
    """Return functions that set every header's stamp in a message to zero, also in lists of messages."""

    def blank_stamp(header: Any) -> None:
        header.stamp.sec = header.stamp.nanosec = 0

    def inside(name: str, is_list: bool, below: list[_Blank]) -> _Blank:
        def blank(message: Any) -> None:
            value = getattr(message, name)
            for element in value if is_list else (value,):
                for blank_below in below:
                    blank_below(element)

        return blank

    if type_name == HEADER:
        return [blank_stamp]
    return [
        inside(attribute(field.name), field.type.arity != "single", below)
        for field in codec.definitions.structure(type_name).fields
        if field.type.is_message and (below := _stamps_blank(codec, field.type.base))
    ]
