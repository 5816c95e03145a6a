"""What an error tells a user to type exists: options and commands."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

import pytest

from ros2_mcp.cli import VERBS, parser
from ros2_mcp.model import errors
from support.source import trees

ERRORS = {name for name, kind in vars(errors).items() if isinstance(kind, type) and issubclass(kind, Exception)}


def texts() -> Iterator[tuple[str, str]]:
    """Every text that an error of the server is made with, and its place."""
    for path, tree in trees().items():
        for call in ast.walk(tree):
            if not isinstance(call, ast.Call) or ast.unparse(call.func).rpartition(".")[2] not in ERRORS:
                continue
            for node in ast.walk(call):
                if isinstance(node, ast.Constant) and isinstance(node.value, str):
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
    known = options()
    assert len(known) > 25
    own = [(place, re.sub(r"\b(uv|pip) .*", "", text)) for place, text in texts()]  # others have options of their own
    named = [(place, word) for place, text in own for word in re.findall(r"(?<![\w-])--[a-z][a-z-]*", text)]
    assert len(named) > 5
    assert [(place, word) for place, word in named if word not in known] == []


def test_every_command_that_is_named_exists() -> None:
    named = [(place, verb) for place, text in texts() for verb in re.findall(r"[Rr]un:? ros2-mcp ([a-z]+)", text)]
    assert named and [(place, verb) for place, verb in named if verb not in VERBS] == []


@pytest.mark.parametrize("word", ["--bag", "--tools", "--robot", "--json"])
def test_options_are_found_wherever_they_are_declared(word: str) -> None:
    assert word in options()
