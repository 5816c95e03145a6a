"""DESIGN: rules that hold in every file of the source."""

from __future__ import annotations

import ast
import re

from ros2_mcp.model import errors
from support.source import ROOT, trees

MAY_PRINT = ("src/ros2_mcp/commands/", "src/ros2_mcp_demo/", "src/ros2_mcp/cli.py")


def calls_of(tree: ast.Module, name: str) -> list[int]:
    return [
        node.lineno
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == name
    ]


def prints_elsewhere_than_on_stderr(tree: ast.Module) -> list[int]:
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call)]
    prints = [call for call in calls if isinstance(call.func, ast.Name) and call.func.id == "print"]
    return [call.lineno for call in prints if "sys.stderr" not in [ast.unparse(word.value) for word in call.keywords]]


def test_only_commands_print() -> None:
    elsewhere = {path: tree for path, tree in trees().items() if not path.startswith(MAY_PRINT)}
    assert {path: lines for path, tree in elsewhere.items() if (lines := prints_elsewhere_than_on_stderr(tree))} == {}


def test_no_exception_is_caught_without_saying_which() -> None:
    bare = [
        f"{path}:{node.lineno}"
        for path, tree in trees().items()
        for node in ast.walk(tree)
        if isinstance(node, ast.ExceptHandler) and node.type is None
    ]
    assert bare == []


def test_every_module_says_what_it_is() -> None:
    assert [path for path, tree in trees().items() if not ast.get_docstring(tree)] == []


def test_server_and_bridge_are_checked_strictly() -> None:
    strict = ("src/ros2_mcp/", "src/ros2_mcp_bridge/")
    relaxed = [path for path in trees() if path.startswith(strict) and _pyright_mode(path)]
    assert relaxed == []


def _pyright_mode(path: str) -> str:
    found = re.search(r"^# pyright: (basic|off)", (ROOT / path).read_text(encoding="utf-8"), re.MULTILINE)
    return found[1] if found else ""


def test_every_error_is_drawn_in_the_tree() -> None:
    drawn = re.findall(r"^ {4}[│ ]*[├└]── (\w+)", errors.__doc__ or "", re.MULTILINE)
    defined = [name for name, value in vars(errors).items() if isinstance(value, type) and name != "RobotError"]
    assert sorted(drawn) == sorted(defined)


def test_the_tree_of_errors_shows_who_inherits_from_whom() -> None:
    ancestors = ["RobotError"]
    for branch, name in re.findall(r"^ {4}([│ ]*[├└]── )(\w+)", errors.__doc__ or "", re.MULTILINE):
        depth = len(branch) // 4
        assert [base.__name__ for base in getattr(errors, name).__bases__] == [ancestors[depth - 1]]
        ancestors[depth:] = [name]
