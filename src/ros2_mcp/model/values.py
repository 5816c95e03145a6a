"""The notation of values that JSON cannot express: written by `values/render.py`, read by `values/check.py`."""

from __future__ import annotations

import math
from collections.abc import Mapping

NOT_FINITE: Mapping[str, float] = {"nan": math.nan, "inf": math.inf, "-inf": -math.inf}
"""The strings for floating-point numbers that JSON cannot express."""

EXACT_INTEGER = 2**53
"""Integers beyond this are decimal strings: JSON readers that store numbers as float64 would lose their last digits."""

SUMMARY = "$summary"
"""The key of an object that replaces a value too long to show; its value is the type of that value.

No field can have this name, so a summary is never mistaken for a value.
"""

DIAGONAL = "$diagonal"
"""The key of an object that replaces a square matrix, row by row, that is 0 off the diagonal.

Its value is the diagonal; most covariances are of this form. Unlike a summary it is the whole value, and accepted as
such.
"""


DIAGONAL_EXPLAINED = (
    f'{{"{DIAGONAL}": […]}} is a square matrix, row by row, with 0 beside its diagonal; accepted as such.'
)
"""The explanation in results that contain such a value."""


FIRST_ELEMENTS = "[0:100]"
"""What a hint adds to the path of a list that was summarised, to get elements of it."""


def is_covariance(path: str) -> bool:
    """Return whether the field at a path may be written as its diagonal: its name contains `covariance`."""
    return "covariance" in path.rpartition(".")[2]


def summarised(paths: Mapping[str, str]) -> str:
    """Return a sentence about summarised paths, and how to read their values; empty if there are none.

    Args:
        paths: each with the field to select for more of it.
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
    """Return the number of a string in `NOT_FINITE`, in any case, also with `infinity`; None for other strings."""
    return NOT_FINITE.get(text.lower().replace("infinity", "inf").removeprefix("+"))


def not_finite_text(value: float) -> str:
    """Return the string in `NOT_FINITE` for a number that is not finite; NaN has no sign there."""
    same = math.isnan if math.isnan(value) else value.__eq__
    return next(text for text, number in NOT_FINITE.items() if same(number))
