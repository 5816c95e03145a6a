"""DESIGN: a tool's name leads to its file: tools of `tools/<room>.py` work in `ops/<room>/`."""

from __future__ import annotations

import ast
from pathlib import PurePath

from support.source import trees

TOOLS = "src/ros2_mcp/tools/"
OPS = "ros2_mcp.ops"
SHARED = {
    "acting": "what acts have in common: values filled in, orders to vehicles, what the bridge or a stop ended",
    "results": "what all results have in common, their text, and progress",
    "sources": "what is read from, live or recorded: arguments of tools in several rooms",
    "watch": "changes on the robot, for resources and not for tools",
}
"""Rooms without tools of their own."""


def has_tools(tree: ast.Module) -> bool:
    functions = [node for node in tree.body if isinstance(node, ast.AsyncFunctionDef)]
    calls = [node for function in functions for node in function.decorator_list if isinstance(node, ast.Call)]
    return any(isinstance(call.func, ast.Name) and call.func.id == "tool" for call in calls)


def rooms_used(tree: ast.Module) -> set[str]:
    """The modules and folders directly in `ops/` that a module imports from."""
    froms = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module]
    inside = {str(node.module).split(".")[2] for node in froms if str(node.module).startswith(f"{OPS}.")}
    return inside | {alias.name for node in froms if node.module == OPS for alias in node.names}


def tools_modules() -> dict[str, ast.Module]:
    """The modules with tools by the name of their room."""
    ours = {PurePath(path).stem: tree for path, tree in trees().items() if path.startswith(TOOLS)}
    return {room: tree for room, tree in ours.items() if has_tools(tree)}


def test_the_tools_of_a_room_do_their_work_in_the_room_of_that_name() -> None:
    assert len(tools_modules()) > 5
    used = {(room, used) for room, tree in tools_modules().items() for used in rooms_used(tree) - SHARED.keys()}
    assert [pair for pair in used if len(set(pair)) > 1] == [], (
        "move the tool or its work, so that the tool's name leads to both"
    )


def test_every_room_has_tools_or_says_why_not() -> None:
    paths = [PurePath(path) for path in trees() if path.startswith("src/ros2_mcp/ops/")]
    rooms = {PurePath(path.parts[3]).stem for path in paths} - {"__init__"}
    assert rooms - SHARED.keys() - tools_modules().keys() == set()
