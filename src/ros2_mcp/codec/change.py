"""Has a message changed? Compared by value: exactly, or within a tolerance where one is given for a field."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from ros2_mcp.codec.cdr import Codec
from ros2_mcp.codec.select import numeric_fields, parse_fields, value_at
from ros2_mcp.codec.store import attribute
from ros2_mcp.model.errors import BadValue
from ros2_mcp.model.interfaces import HEADER

EVERY = "*"
_Blank = Callable[[Any], None]


class ChangeDetector:
    """Compares each message with the last one that counted as a change.

    The stamps of headers never count. A field with a tolerance has changed when it differs by more than that, NaN from
    a number included; every other field when it differs at all. The tolerance of `*` holds for every number that is
    not in an array and has none of its own.

    Raises:
        BadValue: for a tolerance that is negative, or whose field is not there, not a number or inside an array.
    """

    def __init__(self, codec: Codec, type_name: str, tolerances: Mapping[str, float]) -> None:
        self._codec = codec
        self._type = type_name
        self._tolerances = _checked(codec, type_name, tolerances)
        self._blank = _stamps_blank(codec, type_name)
        self._last: tuple[bytes, list[Any]] | None = None

    def is_change(self, data: bytes) -> bool:
        """Whether this message (CDR) is the first, or differs from the last that was a change.

        Raises:
            BadData: if it is not a message of the type.
        """
        rest, values = self._parted(data)
        if self._last is not None and rest == self._last[0] and not self._differ(values, self._last[1]):
            return False
        self._last = rest, values
        return True

    def _parted(self, data: bytes) -> tuple[bytes, list[Any]]:
        """The fields that have a tolerance, and the bytes of all the others; of arrays, the length stays there."""
        message = self._codec.decode(self._type, data)
        values = [value_at(message, path) for path in self._tolerances]
        for path, value in zip(self._tolerances, values, strict=True):
            _put(message, path, _zero_like(value))
        for blank in self._blank:
            blank(message)
        return self._codec.encode(self._type, message), values

    def _differ(self, values: list[Any], others: list[Any]) -> bool:
        return any(map(_differ, values, others, self._tolerances.values()))


def _zero_like(value: Any) -> Any:
    return np.zeros_like(cast("NDArray[Any]", value)) if isinstance(value, np.ndarray) else type(value)()


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
    for path, tolerance in tolerances.items():
        if not tolerance >= 0:
            raise BadValue(path, f"{tolerance} is no tolerance.", "Give a number that is not negative.")
        if path != EVERY:
            _check_path(codec, type_name, path)
    every = numeric_fields(codec.definitions, type_name) if EVERY in tolerances else []
    chosen = {path: tolerance for path, tolerance in tolerances.items() if path != EVERY}
    stamps = tuple(f"{path}." for path in _stamp_paths(codec, type_name, ""))
    return {path: tolerances[EVERY] for path in every if not path.startswith(stamps)} | chosen


def _check_path(codec: Codec, type_name: str, path: str) -> None:
    steps = parse_fields(codec.definitions, type_name, [path])[0].steps
    last = steps[-1].field
    if "[" in path or any(step.field.type.arity != "single" for step in steps[:-1]):
        raise BadValue(path, "a tolerance cannot be given for elements.", "Give the whole field.")
    if not last.type.is_number:
        raise BadValue(path, f"{last.type} has no numbers to compare.", "Give a field made of numbers.")


def _stamp_paths(codec: Codec, type_name: str, path: str) -> list[str]:
    """The stamps of headers that are not in lists."""
    found: list[str] = []
    for field in codec.definitions.structure(type_name).fields:
        here = f"{path}.{field.name}".removeprefix(".")
        if field.type.arity != "single" or not field.type.is_message:
            continue
        found += [f"{here}.stamp"] if field.type.base == HEADER else _stamp_paths(codec, field.type.base, here)
    return found


def _stamps_blank(codec: Codec, type_name: str) -> list[_Blank]:
    """What sets every header's stamp in a message to zero, those in lists of messages included."""
    if type_name == HEADER:
        return [_blank_stamp]
    found: list[_Blank] = []
    for field in codec.definitions.structure(type_name).fields:
        below = _stamps_blank(codec, field.type.base) if field.type.is_message else []
        if below:
            found.append(_inside(attribute(field.name), field.type.arity != "single", below))
    return found


def _inside(name: str, is_list: bool, below: list[_Blank]) -> _Blank:
    def blank(message: Any) -> None:
        value = getattr(message, name)
        for element in value if is_list else (value,):
            for blank_below in below:
                blank_below(element)

    return blank


def _blank_stamp(header: Any) -> None:
    header.stamp.sec = header.stamp.nanosec = 0


def _put(message: Any, path: str, value: Any) -> None:
    above, _, name = path.rpartition(".")
    setattr(value_at(message, above) if above else message, attribute(name), value)
