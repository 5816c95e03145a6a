"""Bound tools as functions of the module `robot` of programs."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any

from ros2_mcp.mcp.binding import BoundTool
from ros2_mcp.programs.declare import Function, Use


def function_of(tool: BoundTool) -> Function:
    """Return the function of the module `robot` that calls this tool, with its arguments, result and checks."""
    declaration = tool.declaration
    signature = declaration.arguments()
    # Required parameters come first, so that they can be given by position.
    parameters = sorted(signature.parameters.values(), key=lambda each: each.default is not inspect.Parameter.empty)
    plain = [each.replace(kind=inspect.Parameter.POSITIONAL_OR_KEYWORD) for each in parameters]
    named = {each.name: each for each in plain}
    for alias, name in declaration.aliases.items():  # the binding takes them, and a saved program may have them
        if name in named and alias not in named:
            plain.append(named[name].replace(name=alias, default=None))

    async def perform(use: Use, arguments: Mapping[str, Any]) -> Any:
        return await tool.perform(arguments, use.report, use.session)

    return Function(
        name=declaration.program,
        signature=signature.replace(parameters=plain),
        doc=declaration.description,
        risk="read" if declaration.risk == "read" else "act",
        recorded=declaration.recorded,
        perform=perform,
        tool=declaration.name,
    )
