"""Help of `ros2-mcp call`: the list of tools, or the arguments of one tool. Starts nothing."""

# ruff: noqa: T201 - printing is this module's job

from __future__ import annotations

import shutil
import textwrap
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from ros2_mcp.commands.assignments import written
from ros2_mcp.model.errors import BadInput
from ros2_mcp.model.names import did_you_mean
from ros2_mcp.settings import Settings

if TYPE_CHECKING:
    from ros2_mcp.mcp.binding import BoundTool

_MOST_COLUMNS = 120
"""Longer lines are hard to read."""
_NAME_COLUMNS = 34
"""The longest name of a tool, plus a space."""
_RISKS = {
    "read": "changes nothing",
    "write": "changes the robot's software or this machine's files",
    "actuate": "can move the robot",
    "stop": "stops what was set in motion",
}


def of_call(settings: Settings) -> Settings:
    """Return the settings of `call`, with all tools: for a person the list need not be short."""
    return replace(settings, tools=settings.tools or ("all",))


def found(tools: Mapping[str, BoundTool], name: str) -> BoundTool:
    """Return the tool of that name.

    Raises:
        BadInput: with the most similar name.
    """
    if name not in tools:
        raise BadInput(f"There is no tool {name}.", did_you_mean(name, list(tools), "See: ros2-mcp call"))
    return tools[name]


def print_help(settings: Settings, name: str | None) -> int:
    """Print the list of tools, or the arguments of the tool of that name.

    Raises:
        BadInput: if there is no such tool.
    """
    from ros2_mcp.compose.server import assemble

    tools = assemble(of_call(settings)).toolset.by_name
    columns = min(_MOST_COLUMNS, shutil.get_terminal_size((_MOST_COLUMNS, 0)).columns)
    lines = _list(tools) if name is None else _help(found(tools, name), columns)
    print("\n".join(lines))
    return 0


def _first_sentence(text: str) -> str:
    return " ".join(text.split()).partition(". ")[0].rstrip(".") + "."


def _list(tools: Mapping[str, BoundTool]) -> list[str]:
    def line(tool: BoundTool) -> str:
        return f"  {tool.name:{_NAME_COLUMNS}} {_first_sentence(tool.declaration.description)}"

    lines: list[str] = []
    if usual := [line(tool) for tool in tools.values() if tool.declaration.by_default]:
        lines += ["What a client is offered by default:", *usual, ""]
    others = [tool for tool in tools.values() if not tool.declaration.by_default]
    for group in dict.fromkeys(tool.declaration.group for tool in others):
        theirs = [line(tool) for tool in others if tool.declaration.group == group]
        lines += [f"What a client is offered with --tools default,{group} (`call` has it anyway):", *theirs, ""]
    return [*lines, "What one of them takes: ros2-mcp call TOOL --help"]


def _help(tool: BoundTool, columns: int) -> list[str]:
    schema: Mapping[str, Any] = tool.listed.input_schema
    known: Mapping[str, Mapping[str, Any]] = schema["properties"]
    needed = [name for name in known if name in schema.get("required", ())]
    lines = [f"{tool.name} ({_RISKS[tool.declaration.risk]})", ""]
    for paragraph in tool.declaration.description.split("\n\n"):
        lines += [*textwrap.wrap(" ".join(paragraph.split()), columns), ""]
    for name in [*needed, *(name for name in known if name not in needed)]:
        facts = [_kind(known[name]), "needed" if name in needed else _default(known[name])]
        lines.append(f"  {name}  ({', '.join(filter(None, facts))})")
        inner = textwrap.wrap(known[name].get("description", ""), columns - 6)
        lines += [f"      {one}" for one in inner]
    example = " ".join([tool.name, *(written(name, known[name]) for name in needed)])
    return [*lines, *([""] if known else []), f"For example: ros2-mcp call {example}"]


def _kind(schema: Mapping[str, Any]) -> str:
    """Return the type of an argument in words: `text`, `list of numbers`, or its choices."""
    if choices := schema.get("enum"):
        return " or ".join(map(str, choices))
    kind = schema.get("type", "")
    if kind == "array":
        return f"list of {_kind(schema['items'])}"
    words = {"string": "text", "integer": "whole number", "boolean": "true or false", "object": "JSON object"}
    return words.get(kind, kind or "JSON")


def _default(schema: Mapping[str, Any]) -> str:
    """Return the default of an argument; "" if it is empty."""
    default = schema.get("default")
    return (
        ""
        if default in (None, "", [], {})
        else f"default {str(default).lower() if default in (True, False) else default}"
    )
