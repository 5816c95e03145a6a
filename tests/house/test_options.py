"""What the words of the server tell a user to type exists: options and commands."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

import pytest

from ros2_mcp.cli import VERBS, parser
from support.source import trees

OF_OTHERS = {"--cache", "--until-stdin-closes"}
"""Options of our own programs that are run by the server: the builder of interfaces and the simulated robot."""


def texts() -> Iterator[tuple[str, str]]:
    """Every text of the server that is no documentation of its code, with its place."""
    for path, tree in trees().items():
        if not path.startswith("src/ros2_mcp/"):
            continue
        documentation = {
            id(node.value)
            for node in ast.walk(tree)
            if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        }
        for node in ast.walk(tree):
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in documentation:
                yield f"{path}:{node.lineno}", node.value


def options() -> set[str]:
    """Every option of the command line, those of its commands included."""
    top = parser()
    found = set(re.findall(r"--[a-z][a-z-]*", top.format_help()))
    for action in top._actions:
        for command in getattr(action, "choices", None) or {}:
            found |= set(re.findall(r"--[a-z][a-z-]*", action.choices[command].format_help()))
    return found


def test_every_option_that_is_named_exists() -> None:
    known = options() | OF_OTHERS
    assert len(known) > 25
    named = [(place, word) for place, text in texts() for word in re.findall(r"(?<![\w-])--[a-z][a-z-]*", text)]
    assert [(place, word) for place, word in named if word not in known] == []


def test_every_command_that_is_named_exists() -> None:
    named = [(place, verb) for place, text in texts() for verb in re.findall(r"[Rr]un:? ros2-mcp ([a-z]+)", text)]
    assert named and [(place, verb) for place, verb in named if verb not in VERBS] == []


@pytest.mark.parametrize("word", ["--bag", "--tools", "--robot", "--json"])
def test_options_are_found_wherever_they_are_declared(word: str) -> None:
    assert word in options()
