"""Copies values from the sandbox into plain values of limited size, before any other code walks through them.

A program's value may share its parts, so that thirty small lists are a tree of a billion leaves. It may be nested
without end, or contain types that JSON does not have. So it is copied once, by a walk that counts every step.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, cast

from ros2_mcp.model.errors import BadInput

MOST_PARTS = 20_000
"""The most numbers, texts, lists and objects within one value: a trajectory of 500 points of 6 joints has half as many.
The walk blocks the server for some 10 ms; ten times as many, under load, blocked it for longer than its link may be
silent.
"""
MOST_CHARACTERS = 2_100_000
"""The most characters of all texts and bytes within one value: somewhat more than in the largest message given to a
program.
"""
MOST_NUMBERS = 500_000
"""The most numbers in lists of numbers only, which are checked as a whole at 0.1 µs each: the cells of a map of 35 m ×
35 m.
"""
_FEW = 64
"""Lists up to this length are walked through like all others."""
DEEPEST = 40
"""The deepest nesting of lists and objects: no ROS message is nested half as deep."""
_EXACT_IN_JSON = 2**53
_EXACT = 10**400
"""The largest integer: no message contains a larger integer, and converting it to text would take long."""


def crossed(value: Any, what: str, *, for_json: bool = False) -> Any:
    """Return a copy of plain parts: None, bool, numbers, texts, bytes, lists, and objects with texts as keys.

    Args:
        value: the value from the sandbox.
        what: its name in errors.
        for_json: convert what JSON does not have to text: infinities, NaN, bytes and all other types.

    Raises:
        BadInput: if it is too large or nested too deep; without `for_json`, also for types other than those above.
    """
    left = [MOST_PARTS, MOST_CHARACTERS]
    numbers_left = MOST_NUMBERS

    def spend(characters: int) -> None:
        left[0] -= 1
        left[1] -= characters
        if min(left) < 0:
            most = f"{MOST_PARTS} parts or {MOST_CHARACTERS} characters"
            raise BadInput(f"{what} has more than {most}.", "Give less, or compute it in the program.")

    def text(found: str) -> str:
        spend(len(found))
        return found.encode("utf-8", "replace").decode()  # an unpaired surrogate is not a character

    def numbers(found: Sequence[Any]) -> list[Any] | None:
        """Return a copy of a long list of numbers of one type that need no conversion; None for any other list."""
        nonlocal numbers_left
        kinds = set(map(type, found))
        is_exact = kinds == {int} and max(found) < _EXACT_IN_JSON and min(found) > -_EXACT_IN_JSON
        if not is_exact and (for_json or kinds != {float}):
            return None
        numbers_left -= len(found)
        if numbers_left < 0:
            raise BadInput(f"{what} has more than {MOST_NUMBERS} numbers.", "Give less.")
        return list(found)

    def plain(found: Any, depth: int) -> Any:
        if depth > DEEPEST:
            raise BadInput(f"{what} is nested more than {DEEPEST} times.")
        if isinstance(found, str):
            return text(found)
        if found is None or isinstance(found, bool):
            spend(1)
            return found
        if isinstance(found, (int, float)):
            spend(8)
            return _number(found, what, for_json=for_json)
        if isinstance(found, (list, tuple, set, frozenset)):
            spend(1)
            parts = cast("Sequence[Any]", found)
            is_long = len(parts) > _FEW and isinstance(found, (list, tuple))
            if is_long and (copied := numbers(parts)) is not None:
                return copied
            return [plain(each, depth + 1) for each in parts]
        if isinstance(found, Mapping):
            spend(1)
            items = cast("Mapping[Any, Any]", found).items()
            return {_key(name, text, what, for_json): plain(below, depth + 1) for name, below in items}
        if isinstance(found, (bytes, bytearray)) and not for_json:
            spend(len(found))
            return bytes(found)
        if not for_json:
            raise BadInput(f"{what}: a {type(found).__name__} is not a value that the robot accepts.")
        spend(100)
        return f"<{type(found).__name__}>"

    return plain(value, 0)


def _number(found: float, what: str, *, for_json: bool) -> Any:
    if isinstance(found, int):
        if abs(found) > _EXACT:
            raise BadInput(f"{what}: a number of more than 400 digits.")
        return str(found) if for_json and abs(found) >= _EXACT_IN_JSON else found
    return str(found) if for_json and not math.isfinite(found) else found


def _key(name: Any, text: Any, what: str, for_json: bool) -> str:
    if isinstance(name, str) or (for_json and isinstance(name, (int, float, bool)) and abs(name) < _EXACT):
        return str(text(str(name)))
    raise BadInput(f"{what}: the name of a field is a string, not a {type(name).__name__}.")
