"""The panels of a page: one module for each, discovered automatically."""

from __future__ import annotations

import pkgutil
from collections.abc import Sequence
from functools import cache
from importlib import import_module

from ros2_mcp.view.look import Panel


@cache
def panel_types() -> Sequence[type[Panel]]:
    """Return all panels, by name.

    They are imported when the first page opens, because they need the drawing libraries.
    """
    for found in pkgutil.iter_modules(__path__):
        import_module(f"{__name__}.{found.name}")
    return sorted(Panel.__subclasses__(), key=lambda kind: kind.name)
