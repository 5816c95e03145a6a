"""Numbers that are not finite, which JSON does not have."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, cast


def finite(value: Any, instead: Callable[[float], str | None] = lambda _: None) -> Any:
    """The same value with null, or what is to stand there, for each number that is none, or infinite."""
    if isinstance(value, float):
        return value if math.isfinite(value) else instead(value)
    if isinstance(value, Mapping):
        return {name: finite(inner, instead) for name, inner in cast("Mapping[str, Any]", value).items()}
    if isinstance(value, (list, tuple)):
        return [finite(inner, instead) for inner in cast("list[Any]", value)]
    return value
