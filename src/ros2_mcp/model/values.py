"""How values look where JSON has no way to write them: what `codec/render` writes, `codec/check` reads back."""

from __future__ import annotations

import math
from collections.abc import Mapping

NOT_FINITE: Mapping[str, float] = {"nan": math.nan, "inf": math.inf, "-inf": -math.inf}
"""The texts that stand for floating-point numbers that JSON cannot write, in both directions."""

EXACT_INTEGER = 2**53
"""Integers beyond this are decimal strings: JSON readers that keep numbers as float64 would lose their last digits."""

SUMMARY = "$summary"
"""The key of an object that stands for a value too long to show; it holds the value's type.

No field can have this name, so a summary is never mistaken for a value.
"""


def not_finite_text(value: float) -> str:
    """The text of `NOT_FINITE` for a number that is not finite; a NaN has no sign there."""
    same = math.isnan if math.isnan(value) else value.__eq__
    return next(text for text, number in NOT_FINITE.items() if same(number))
