"""What the model sees: one module per family of tools."""

from ros2_mcp.tools import (
    actions,
    graph,
    history,
    log,
    measure,
    memory,
    parameters,
    pictures,
    publishing,
    relay,
    services,
    stop,
    topics,
)
from ros2_mcp.tools.declare import DECLARED, ToolDeclaration

__all__ = ["GROUPS", "TOOLS", "ToolDeclaration"]

_FAMILIES = (
    graph,
    topics,
    measure,
    pictures,
    log,
    publishing,
    stop,
    services,
    actions,
    parameters,
    relay,
    history,
    memory,
)

TOOLS = [tool for family in _FAMILIES for tool in DECLARED if tool.function.__module__ == family.__name__]
"""Every tool, in the order of `tools/list`."""

GROUPS = tuple(dict.fromkeys(tool.group for tool in TOOLS))
"""The groups that a user can choose."""
