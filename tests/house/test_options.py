"""What errors and documents tell a user to type exists: options and commands."""

from __future__ import annotations

import ast
import re
import shlex
from collections.abc import Iterator
from itertools import takewhile
from pathlib import PurePath

import pytest

from ros2_mcp.cli import VERBS, _options_first, parser
from ros2_mcp.model import errors
from support.source import committed_texts, trees

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


OF_OTHERS = {"-t", "-u", "venv"}
"""After them stands a name or a folder, not our command: docker build -t, journalctl -u, python -m venv."""
OF_THE_SHELL = {">", "|", "&&"}


def documented() -> Iterator[tuple[str, list[str]]]:
    """Every command line of ours in a document's blocks of shell: the page, and the words behind `ros2-mcp`."""
    by_hand = re.compile(r"(README|CONTRIBUTING|docs/tutorial|docs/(how-to|explanation)/.*)\.md")
    for page, text in committed_texts().items():
        blocks = re.findall(r"^ *```sh\n(.*?)```", text, re.DOTALL | re.MULTILINE) if by_hand.fullmatch(page) else ()
        for line in "".join(blocks).replace("\\\n", " ").splitlines():
            words = shlex.split(line, comments=True)
            for at, word in enumerate(words):
                is_command = PurePath(word).name == "ros2-mcp" and words[max(0, at - 1)] not in OF_OTHERS
                if is_command and "[OPTIONS]" not in words:
                    yield page, list(takewhile(lambda one: one not in OF_THE_SHELL, words[at + 1 :]))


def test_every_command_of_the_documents_is_one_that_the_command_line_takes(capsys: pytest.CaptureFixture[str]) -> None:
    found, wrong, top = list(documented()), list[tuple[str, str, str]](), parser()
    assert len(found) > 60
    for page, words in found:
        if "ros2-mcp" in words:  # docker run … ros2-mcp OPTIONS: found once more
            continue
        try:
            top.parse_args(_options_first(words))
        except SystemExit as end:
            if end.code:
                wrong.append((page, shlex.join(words), capsys.readouterr().err.splitlines()[-1]))
    assert wrong == []
