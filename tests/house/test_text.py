"""Text of the robot is made visible where it leaves, once; and summaries make no lines of their own (decision 23)."""

from __future__ import annotations

import ast

from support.source import trees

OUTLETS = (
    *(
        "mcp/binding",
        "mcp/server",
        "mcp/transports/jsonrpc",
        "mcp/completions",
        "cli",
        "commands/call",
        "commands/doctor",
        "commands/serve",
    ),
    *("commands/operate", "commands/audit", "commands/view", "view/views"),
    *("resources/fitting", "resources/offering", "resources/push", "prompts/serving", "prompts/mistakes"),
    *("ops/results/text", "model/cells"),  # the text of a result, which is only made to leave
)
MEASURE = ("values/render", "ops/log/read")
"""These only measure how long a text will be when it is shown."""


def users_of(*names: str) -> set[str]:
    """The modules that import one of these from `model/text.py`."""
    return {
        path.removeprefix("src/ros2_mcp/").removesuffix(".py")
        for path, tree in trees().items()
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom)
        and node.module == "ros2_mcp.model.text"
        and any(alias.name in names for alias in node.names)
    }


def test_only_outlets_make_text_visible() -> None:
    assert users_of("visible", "visible_json") <= {*OUTLETS, *MEASURE}


def test_only_the_binding_takes_escapes_back() -> None:
    assert users_of("as_sent") == {"mcp/binding"}


def test_a_summary_gives_its_lines_as_a_list() -> None:
    with_breaks = [
        f"{path}:{node.lineno}"
        for path, tree in trees().items()
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef) and node.name == "summary"
        for part in ast.walk(node)
        if isinstance(part, ast.Constant)
        and isinstance(part.value, str)
        and "\n" in part.value
        and part.value != ast.get_docstring(node, clean=False)
    ]
    assert not with_breaks
