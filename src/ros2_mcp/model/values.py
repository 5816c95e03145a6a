"""How values look where JSON has no way to write them: what `codec/render` writes, `codec/check` reads back."""

from __future__ import annotations

import math
from collections.abc import Mapping

NOT_FINITE: Mapping[str, float] = {"nan": math.nan, "inf": math.inf, "-inf": -math.inf}
"""The texts that stand for floating-point numbers that JSON cannot write, as they are shown."""

EXACT_INTEGER = 2**53
"""Integers beyond this are decimal strings: JSON readers that keep numbers as float64 would lose their last digits."""

SUMMARY = "$summary"
"""The key of an object that stands for a value too long to show; it holds the value's type.

No field can have this name, so a summary is never mistaken for a value.
"""

DIAGONAL = "$diagonal"
"""The key of an object that stands for a square matrix, row by row, of which only the diagonal is not 0.

It holds the diagonal: what most covariances are. Unlike a summary it is the whole value, and accepted as such.
"""


DIAGONAL_EXPLAINED = (
    f'{{"{DIAGONAL}": […]}} is a square matrix, row by row, with 0 beside its diagonal; accepted as such.'
)
"""What is said where there is one."""


FIRST_ELEMENTS = "[0:100]"
"""What a hint adds to the path of a list that was summarised, to get elements of it."""


def is_covariance(path: str) -> bool:
    """Whether the field at a path may be written as its diagonal: by its name it is a covariance."""
    return "covariance" in path.rpartition(".")[2]


def summarised(paths: Mapping[str, str]) -> str:
    """What is said of paths whose values are summaries, and how to get the values; empty where there are none.

    Args:
        paths: each with the field that shows more of it.
    """
    if not paths:
        return ""
    named = ", ".join(path or "the whole message" for path in list(paths)[:8])
    more = next((field for path, field in paths.items() if path and "[" not in path), "")
    such = f', such as fields=["{more}"]' if more else ""
    such += " (characters)" if more.endswith("]") and not more.endswith(FIRST_ELEMENTS) else ""
    is_list = any(field.endswith(FIRST_ELEMENTS) for field in paths.values())
    larger = ", or a larger max_array" if is_list else ""
    return f"Summarised: {named}. For more, give fields{such}{larger}."


def not_finite_number(text: str) -> float | None:
    """The number that a text of `NOT_FINITE` stands for, in any case, `infinity` written out too; None for others."""
    return NOT_FINITE.get(text.lower().replace("infinity", "inf").removeprefix("+"))


def not_finite_text(value: float) -> str:
    """The text of `NOT_FINITE` for a number that is not finite; a NaN has no sign there."""
    same = math.isnan if math.isnan(value) else value.__eq__
    return next(text for text, number in NOT_FINITE.items() if same(number))
