"""Fast access to the numbers of an rclpy message: their names are found once for a type, then read in one call."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache
from operator import attrgetter
from typing import Any

from ros2_mcp_common.policy.checks import Checks
from ros2_mcp_common.policy.field_values import at, fields_of, get

Numbers = Callable[[Any], Sequence[float]]


def reader(names: Sequence[str]) -> Numbers:
    """Return a function that reads the fields with these names, such as `linear.x`, from a message."""
    if len(names) > 1:
        return attrgetter(*names)
    return lambda message: [attrgetter(name)(message) for name in names]


# Only few types of a robot are commands, and an entry holds only some names.
@lru_cache(maxsize=64)
def floats_of(message_class: Any) -> tuple[tuple[str, ...], Numbers]:
    """Return the names of all floating-point fields of a message class, nested fields included but not lists, and their
    reader.
    """
    names = tuple(_floats(message_class()))
    return names, reader(names)


def _floats(message: Any, prefix: str = "") -> list[str]:
    found: list[str] = []
    for name in message.get_fields_and_field_types():
        value = getattr(message, name)
        if isinstance(value, float):
            found.append(prefix + name)
        elif hasattr(value, "get_fields_and_field_types"):
            found += _floats(value, f"{prefix}{name}.")
    return found


def names_at(message: Any, path: str) -> list[str]:
    """Return the names of the numbers at or below a path of a rule: the same names for every message of the type.

    Raises:
        Unfit: if there is no such field.
        ValueError: if a list is at or below the path: the next message may have more elements.
    """
    if "[]" in path:
        raise ValueError(f"{path} leads into a list")
    return [name for shown, found in at(message, path) for name in _names(found, shown)]


def _names(value: Any, name: str) -> Iterator[str]:
    if below := fields_of(value):
        for each in below:
            yield from _names(get(value, each), f"{name}.{each}".lstrip("."))
    elif isinstance(value, (float, int)) and not isinstance(value, bool):
        yield name
    else:
        raise ValueError(f"{name} is no single number")


class QuickCheck:
    """A test that proves most messages of one type to be within these checks, in a few microseconds.

    A message that it does not prove to be within, such as one with a float32 that was rounded up, needs the full check
    (`checks.problem`). Some kinds of checks are not supported: `of` then returns None.
    """

    def __init__(self, checks: Sequence[Checks], message: Any) -> None:
        names: dict[str, int] = {}

        def places(path: str) -> list[int]:
            return [names.setdefault(name, len(names)) for name in names_at(message, path)]

        self._zero = [place for each in checks for path in each.zero for place in places(path)]
        self._norm = [(places(path), most) for each in checks for path, most in each.norm.items()]
        self._range = [
            (place, low, high) for each in checks for path, (low, high) in each.range.items() for place in places(path)
        ]
        self._read = reader(list(names))

    @classmethod
    def of(cls, checks: Sequence[Checks], message: Any) -> QuickCheck | None:
        """Return the quick check for messages like this message, or None if no quick check exists."""
        if any(each.one_of or each.count or each.zone or each.pace or each.curve or each.keep_out for each in checks):
            return None
        try:
            return cls(checks, message)
        except Exception:  # noqa: BLE001 - of any odd message; no quick check then, and the full check names the reason
            return None

    def is_within(self, message: Any) -> bool:
        """Return True if the message is proven to be within the limits. NaN never is."""
        found = self._read(message)
        return (
            all(found[place] == 0.0 for place in self._zero)
            and all(math.hypot(*[found[place] for place in places]) <= most for places, most in self._norm)
            and all(low <= found[place] <= high for place, low, high in self._range)
        )


def put(message: Any, values: Mapping[str, float]) -> None:
    """Set the numbers with these names in a message."""
    for name, value in values.items():
        owner, _, field = name.rpartition(".")
        setattr(attrgetter(owner)(message) if owner else message, field, value)
