"""How values look where JSON has no way to write them: what `codec/render` writes, `codec/check` reads back."""

from __future__ import annotations

import math
from collections.abc import Mapping

NOT_FINITE: Mapping[str, float] = {"nan": math.nan, "inf": math.inf, "-inf": -math.inf}
"""The texts that stand for floating-point numbers that JSON cannot write."""

EXACT_INTEGER = 2**53
"""Integers beyond this are decimal strings: JSON readers that keep numbers as float64 would lose their last digits."""

SUMMARY = "$summary"
"""The key of an object that stands for a value too long to show; it holds the value's type.

No field can have this name, so a summary is never mistaken for a value.
"""
