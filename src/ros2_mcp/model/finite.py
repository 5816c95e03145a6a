"""Replace NaN and infinities, which JSON does not have."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, cast


def finite(value: Any, instead: Callable[[float], str | None] = lambda _: None) -> Any:
    """Return the value with each NaN and infinity replaced by the result of `instead`, by default null."""
    if isinstance(value, float):
        return value if math.isfinite(value) else instead(value)
    if isinstance(value, Mapping):
        return {name: finite(inner, instead) for name, inner in cast("Mapping[str, Any]", value).items()}
    if isinstance(value, (list, tuple)):
        return [finite(inner, instead) for inner in cast("list[Any]", value)]
    return value
