"""The tools of several robots as one list: each tool once, with the argument `robot`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from mcp.types import Tool, ToolAnnotations

from ros2_mcp.mcp.binding import BoundTool, answer_schema
from ros2_mcp.mcp.fleet.about_all import ROBOTS, STOP, RobotStates, StoppedRobots
from ros2_mcp.mcp.fleet.member import Member
from ros2_mcp.tools import PAGE_TOOLS, TOOLS, ToolDeclaration

ROBOT = "robot"
_MOST_IN_ENUM = 15
"""Each name costs the model one or two tokens in every tool. Of more robots, only ros2_robots lists the names."""
_STOP_ALL = "Without robot it stops all robots of this server at the same time."


def listed_tools(members: Sequence[Member]) -> list[Tool]:
    """Return every tool that at least one robot offers, in the order of `tools/list`; `ros2_robots` is first.

    A tool's `robot` allows the robots that offer it: for a read-only robot, tools that write are not offered.
    """
    return [_robots_tool(), *_merged(TOOLS, {member.name: member.toolset.by_name for member in members})]


def listed_with_pages(members: Sequence[Member]) -> list[Tool]:
    """Return the further tools for clients that show pages, in the same form."""
    return _merged((*TOOLS, *PAGE_TOOLS), {member.name: member.toolset.with_pages for member in members})


def _merged(declarations: Sequence[ToolDeclaration], offered: Mapping[str, Mapping[str, BoundTool]]) -> list[Tool]:
    found: list[Tool] = []
    for declared in declarations:
        offering = {name: tools[declared.name] for name, tools in offered.items() if declared.name in tools}
        if not offering:
            continue
        # Descriptions omit sentences about tools that are not offered: the longest description has them all.
        tools = [bound.listed for bound in offering.values()]
        tool = max(tools, key=lambda tool: len(tool.description or ""))
        found.append(_with_robot(tool, [*offering], is_stop=declared.name == STOP))
    return found


def _with_robot(tool: Tool, names: Sequence[str], *, is_stop: bool) -> Tool:
    taken: Mapping[str, Any] = tool.input_schema
    told = [] if len(names) <= _MOST_IN_ENUM else [f"Name of a robot, from {ROBOTS}."]
    told += ["Default: all."] if is_stop else []
    # Kept short, because it is in every tool; the instructions explain it once.
    argument: dict[str, Any] = {"type": "string"}
    argument |= {"enum": list(names)} if len(names) <= _MOST_IN_ENUM else {}
    argument |= {"description": " ".join(told)} if told else {}
    required = [*(() if is_stop else (ROBOT,)), *taken.get("required", ())]
    schema = {**taken, "properties": {ROBOT: argument, **taken["properties"]}}
    if required:
        schema["required"] = required
    if is_stop:
        description = f"{tool.description} {_STOP_ALL}"
        update = {"description": description, "output_schema": answer_schema(StoppedRobots)}
    else:
        update: dict[str, Any] = {}
        if given := tool.output_schema:
            properties = {ROBOT: {"type": "string"}, **given.get("properties", {})}
            required = [ROBOT, *given.get("required", ())]
            update["output_schema"] = {**given, "properties": properties, "required": required}
    return tool.model_copy(update={"input_schema": schema, **update})


def _robots_tool() -> Tool:
    title = "The robots of this server"
    return Tool(
        name=ROBOTS,
        title=title,
        description="Show the robots of this server: the address of each, whether it can be reached, and its policy. "
        "Connects to robots that were not used yet, and waits for them briefly.",
        input_schema={"type": "object", "properties": {}, "additionalProperties": False},
        output_schema=answer_schema(RobotStates),
        _meta={"anthropic/searchHint": "which robots are there, connected, reachable"},
        annotations=ToolAnnotations(
            title=title, read_only_hint=True, destructive_hint=False, idempotent_hint=True, open_world_hint=False
        ),
    )
