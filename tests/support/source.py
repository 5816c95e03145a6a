"""What the house rules look at: our source files, parsed."""

from __future__ import annotations

import ast
import subprocess
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from support.processes import ROOT

PACKAGES = ("ros2_mcp", "ros2_mcp_bridge", "ros2_mcp_common", "ros2_mcp_demo", "ros2_mcp_interfaces")

Function = ast.FunctionDef | ast.AsyncFunctionDef


@cache
def modules() -> dict[str, str]:
    """The text of every module by its path, such as `src/ros2_mcp/cli.py`."""
    found = [path for package in PACKAGES for path in sorted((ROOT / "src" / package).rglob("*.py"))]
    return {str(path.relative_to(ROOT)): path.read_text(encoding="utf-8") for path in found}


@cache
def trees() -> dict[str, ast.Module]:
    """The syntax tree of every module by its path."""
    return {path: ast.parse(text) for path, text in modules().items()}


def functions() -> Iterator[tuple[str, Function]]:
    """Every function of ours, with `path:name`."""
    for path, tree in trees().items():
        for node in ast.walk(tree):
            if isinstance(node, Function):
                yield f"{path}:{node.name}", node


def lines_of_code(function: Function) -> int:
    """The lines of a function's body without its docstring."""
    body = function.body[1:] if ast.get_docstring(function) else function.body
    return body[-1].end_lineno - body[0].lineno + 1 if body else 0  # type: ignore[operator]


@cache
def committed_texts() -> dict[str, str]:
    """Every text file that git tracks or would track, by its path."""
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"],
        cwd=ROOT,
        capture_output=True,
        check=True,
        text=True,
    )
    paths = [name for name in listed.stdout.split("\0") if name and (ROOT / name).is_file()]
    return {name: text for name in paths if (text := _text(ROOT / name)) is not None}


def _text(path: Path) -> str | None:
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        return None
