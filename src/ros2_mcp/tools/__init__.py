"""What the model sees: one module per family of tools. Modules of this package are discovered automatically.

`PLACE` of a module is the position of its tools in `tools/list`, lowest first. The list must be the same for every
connection, and models read it from the top, so tools that are used first come first. Tools with the same place keep the
order of their declaration. A tool may have a `place` of its own, next to tools of another module.
"""

import pkgutil
from collections.abc import Iterable
from importlib import import_module

from ros2_mcp.tools.declare import DECLARED, ToolDeclaration

__all__ = ["GROUPS", "PAGE_TOOLS", "TOOLS", "ToolDeclaration", "in_order"]

_MODULES = [import_module(f"{__name__}.{found.name}") for found in pkgutil.iter_modules(__path__)]
_LAST = 1000
"""Place of the tools of a module without `PLACE`: last."""
_PLACES: dict[str, int] = {module.__name__: getattr(module, "PLACE", _LAST) for module in _MODULES}


def in_order(tools: Iterable[ToolDeclaration]) -> list[ToolDeclaration]:
    """Return the tools in the order of `tools/list`."""

    def place(tool: ToolDeclaration) -> int:
        return _PLACES.get(tool.function.__module__, _LAST) if tool.place is None else tool.place

    return sorted(tools, key=place)


TOOLS = in_order(tool for tool in DECLARED if tool.audience == "model")
"""Every tool, in the order of `tools/list`."""

PAGE_TOOLS = in_order(tool for tool in DECLARED if tool.audience == "page")
"""Tools that only the page calls, through a chat host; at the end of the list for such hosts."""

GROUPS = tuple(dict.fromkeys(tool.group for tool in TOOLS))
"""The groups that a user can choose."""
