"""The names of tools in our own texts: an error that names a tool which does not exist sends a model astray."""

from __future__ import annotations

import ast
import re
from functools import cache

from ros2_mcp.mcp.fleet.about_all import ROBOTS
from ros2_mcp.tools import PAGE_TOOLS, TOOLS
from support.source import trees

NAME = re.compile(r"(?<![\w/.])ros2_[a-z][a-z0-9_]*")
OTHERS = re.compile(r"ros2_mcp(_.*)?|ros2_control_?")
"""What begins like a tool's name and is none: our packages, and a package of ROS 2."""


def named(text: str) -> set[str]:
    return {name for name in NAME.findall(text) if not OTHERS.fullmatch(name)}


@cache
def tools() -> set[str]:
    """Every name under which a tool can be called: today's names, and the old ones that still work."""
    return {name for tool in (*TOOLS, *PAGE_TOOLS) for name in (tool.name, tool.also_named) if name} | {ROBOTS}


def test_every_tool_that_a_text_names_exists() -> None:
    found = {
        f"{path}: {name}"
        for path, tree in trees().items()
        if path.startswith("src/ros2_mcp/")
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
        for name in named(node.value) - tools()
    }
    assert found == set()


def test_a_name_that_looks_like_a_tool_is_found_in_a_text() -> None:
    text = "Start ros2_control; ros2_list_nodes(all=true) shows what runs in ros2_mcp_bridge, /ros2_x and a.ros2_y."
    assert named(text) == {"ros2_list_nodes"}
