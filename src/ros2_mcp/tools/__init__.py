"""What the model sees: one module per family of tools. Every module of this folder is found by itself.

A module says with `PLACE` where its tools stand in `tools/list`: the list must be the same for every connection, and
models read it from the top, so what is looked at first stands first. Within a module it is the order of declaration.
"""

import pkgutil
from importlib import import_module

from ros2_mcp.tools.declare import DECLARED, ToolDeclaration

__all__ = ["GROUPS", "TOOLS", "ToolDeclaration"]

_MODULES = [import_module(f"{__name__}.{found.name}") for found in pkgutil.iter_modules(__path__)]
_PLACES = {module.__name__: getattr(module, "PLACE", 1000) for module in _MODULES}

TOOLS = sorted(DECLARED, key=lambda tool: _PLACES[tool.function.__module__])
"""Every tool, in the order of `tools/list`."""

GROUPS = tuple(dict.fromkeys(tool.group for tool in TOOLS))
"""The groups that a user can choose."""
