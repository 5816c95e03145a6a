"""The panels of a page: one module for each, found by itself."""

from __future__ import annotations

import pkgutil
from collections.abc import Sequence
from functools import cache
from importlib import import_module

from ros2_mcp.view.look import Panel


@cache
def panel_types() -> Sequence[type[Panel]]:
    """All of them, by name. Their modules are imported when the first page opens: they need what draws pictures."""
    for found in pkgutil.iter_modules(__path__):
        import_module(f"{__name__}.{found.name}")
    return sorted(Panel.__subclasses__(), key=lambda kind: kind.name)
