"""Numbers in messages that are not finite: they are not used in calculations, and results name them as unknown.

Used by server and bridge alike. Needs no ROS: works with any object that has the fields of a message.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, cast


def not_finite(message: Any, *paths: str, within: str = "") -> str:
    """Return the first number below these paths of a message that is NaN or infinite, as `pose.position.x is NaN`;
    empty if all are finite.

    A path leads to a number, a list or a message; every number in it is checked. `within` is the path of the message
    itself, for the name: `pose.pose`.
    """
    for path in paths:
        value = message
        for step in path.split("."):
            value = getattr(value, step)
        for name, number in _numbers(value, f"{within}.{path}" if within else path):
            if not math.isfinite(number):
                return f"{name} is {word_for(number)}"
    return ""


def word_for(number: float) -> str:
    """Return the word for a number that is not finite: NaN, infinite, negative infinite."""
    return "NaN" if math.isnan(number) else "infinite" if number > 0 else "negative infinite"


def in_words(number: float, form: str = "g") -> str:
    """Return a number in that format, or that it is unknown if it is not finite."""
    return format(number, form) if math.isfinite(number) else f"unknown ({word_for(number)})"


def _numbers(value: Any, name: str) -> Iterator[tuple[str, float]]:
    if isinstance(value, (int, float)):
        yield name, value
    elif isinstance(value, str):
        return
    elif hasattr(value, "__getitem__") and hasattr(value, "__len__"):  # a list, or an array of NumPy or the library
        for at, one in enumerate(cast("Sequence[Any]", value)):
            yield from _numbers(one, f"{name}[{at}]")
    elif hasattr(value, "__float__"):  # a number of NumPy
        yield name, float(value)
    else:
        for field in _fields(value):
            yield from _numbers(getattr(value, field), f"{name}.{field}")


def _fields(message: Any) -> Sequence[str]:
    """Return the names of the fields of an rclpy message, a dataclass, or any other object."""
    if hasattr(message, "get_fields_and_field_types"):
        return list(message.get_fields_and_field_types())
    names = cast("Iterable[str]", getattr(message, "__dataclass_fields__", None) or vars(message))
    return [name for name in names if name[0] != "_"]
