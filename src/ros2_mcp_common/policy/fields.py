"""The numbers of a message of rclpy, found once for its type and then read in one call, at the speed of C."""

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
    """A function that reads the fields of these names, such as `linear.x`, from a message."""
    if len(names) > 1:
        return attrgetter(*names)
    return lambda message: [attrgetter(name)(message) for name in names]


# Few types of a robot are commands; what is kept of each is some names.
@lru_cache(maxsize=64)
def floats_of(message_class: Any) -> tuple[tuple[str, ...], Numbers]:
    """The names of all floating-point numbers of a message and of those in it, but those in lists; and their reader."""
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
    """The names of the numbers at or below a path of a rule, the same for every message of a type.

    Raises as `at`, and `ValueError` where a list is at or below it: the next message may have more in it than this one.
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
    """Says of most messages of one type that they are surely within these checks, in a few microseconds.

    What it does not say that of, such as a float32 that was rounded up, is for `problem_of` to judge. It does not know
    all kinds of checks: `of` then gives None.
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
        """The quick check for messages like this one; None where there is none."""
        if any(each.one_of or each.count or each.zone or each.pace or each.curve for each in checks):
            return None
        try:
            return cls(checks, message)
        except Exception:  # noqa: BLE001 - a field that is not there, a list: the full judge says so in words
            return None

    def is_within(self, message: Any) -> bool:
        """Whether it is surely within; NaN never is."""
        found = self._read(message)
        return (
            all(found[place] == 0.0 for place in self._zero)
            and all(math.hypot(*[found[place] for place in places]) <= most for places, most in self._norm)
            and all(low <= found[place] <= high for place, low, high in self._range)
        )


def put(message: Any, values: Mapping[str, float]) -> None:
    """Set numbers of a message by their names."""
    for name, value in values.items():
        owner, _, field = name.rpartition(".")
        setattr(attrgetter(owner)(message) if owner else message, field, value)
