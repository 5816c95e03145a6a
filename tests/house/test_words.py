"""One concept has one word (docs/glossary.md), as far as names of modules, classes, functions and values show it."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import PurePath

import pytest

from support.source import trees

EVERYWHERE = "src/"
THE_STREAM = ("src/ros2_mcp/link/", "src/ros2_mcp_bridge/")
OLD_WORDS: dict[str, tuple[str, str | tuple[str, ...]]] = {
    "door": ("robot", EVERYWHERE),
    "will": ("fail-safe", EVERYWHERE),
    "deed": ("fail-safe", EVERYWHERE),
    "exchange": ("request, reply, or the command's name", EVERYWHERE),
    "Wanted": ("<Verb>Request, or the Command itself", EVERYWHERE),
    "Asked": ("<Verb>Request, or the Selection", EVERYWHERE),
    "moment": ("time, or span", EVERYWHERE),
    "frame": ("packet; a frame is a coordinate frame", THE_STREAM),
    "transport": ("carrier; the transport is MCP's", THE_STREAM),
}
"""Old word → the right one, and where the old one must not be. A word with a capital is one only as a class's name."""
VAGUE_WORDS = ("manager", "handler", "helper", "util")
FOREIGN = {"BasePromptHandler"}
"""Names that others have given and that we only repeat."""


def names(path: str, tree: ast.Module) -> Iterator[str]:
    """Every name that a module gives; not those that it only uses."""
    yield from PurePath(path).with_suffix("").parts[1:]
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            yield node.name
        elif isinstance(node, ast.arg):
            yield node.arg
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.attr


def words(name: str) -> set[str]:
    """`_last_Deeds` → last, deed, Deed: each part of a name in the singular, and in lower case too.

    `frame_id` is a word of ROS, and always a coordinate frame.
    """
    name = re.sub("frame_id|FrameId", "", name)
    parts = {re.sub("[sS]$", "", part) for part in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", name)}
    return parts | {part.lower() for part in parts}


@cache
def words_of_names() -> dict[str, dict[str, set[str]]]:
    """For each module the words of each of its names."""
    return {path: {name: words(name) for name in {*names(path, tree)} - FOREIGN} for path, tree in trees().items()}


def with_the_word(old: str, below: str | tuple[str, ...]) -> list[str]:
    found = {path: names for path, names in words_of_names().items() if path.startswith(below)}
    return sorted(f"{path}: {name}" for path, names in found.items() for name, parts in names.items() if old in parts)


def test_a_name_is_taken_apart_into_its_words() -> None:
    assert words("_last_deeds") == {"last", "deed"}
    assert {"Wanted", "wanted", "Topic", "topic"} == words("WantedTopics")
    assert {"last", "deed"} < words("LAST_DEEDS_S")


@pytest.mark.parametrize("word", VAGUE_WORDS)
def test_names_say_what_a_thing_does(word: str) -> None:
    assert with_the_word(word, EVERYWHERE) == []


@pytest.mark.parametrize("word", OLD_WORDS)
def test_one_concept_has_one_word(word: str) -> None:
    right, below = OLD_WORDS[word]
    assert with_the_word(word, below) == [], f"say: {right}"
