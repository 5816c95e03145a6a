"""Numbers that are not finite, which JSON does not have."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, cast


def finite(value: Any) -> Any:
    """The same value with null for each number that is none, or infinite."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {name: finite(inner) for name, inner in cast("Mapping[str, Any]", value).items()}
    if isinstance(value, (list, tuple)):
        return [finite(inner) for inner in cast("list[Any]", value)]
    return value
