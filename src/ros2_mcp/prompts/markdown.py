"""Prompts out of Markdown files: the front matter says name, description and arguments, the text is the message."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass
from typing import Any

from ros2_mcp.model.argument_entries import arguments_under
from ros2_mcp.model.front_matter import Entry, FrontMatterError, split
from ros2_mcp.model.names import did_you_mean
from ros2_mcp.prompts import template
from ros2_mcp.prompts.mistakes import Mistake
from ros2_mcp.prompts.prompt import Message, Prompt

MAX_CHARACTERS = 100_000
"""The longest file that is read; a longer one is no prompt, and would fill a model's context."""
_PROMPT_KEYS = ("name", "title", "description", "arguments")
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")
_CALL = re.compile(r"\bCall `?(ros2_\w+)")


@dataclass(frozen=True, slots=True)
class Parsed:
    """What a file gave: a prompt unless it cannot be used, its name's line, and what is wrong with it."""

    prompt: Prompt | None
    line: int
    mistakes: Sequence[Mistake]


def parse(where: str, name: str, text: str, known_tools: Set[str] = frozenset()) -> Parsed:
    """The prompt in the text of a file.

    Args:
        where: the file, as mistakes shall name it.
        name: the prompt's name if the front matter has none.
        text: the whole file.
        known_tools: every tool there is; calls of others are mistakes. Empty: not checked.
    """
    try:
        front, body, first_line = split(text)
        prompt = _prompt(front, name, body)
    except FrontMatterError as error:
        return Parsed(None, error.line, [Mistake(where, error.line, error.text)])
    found = list(template.mistakes_of(body, {argument.name for argument in prompt.arguments}))
    for number, line in enumerate(body.split("\n")):
        for tool in _CALL.findall(line) if known_tools else ():
            if tool not in known_tools:
                hint = did_you_mean(tool, sorted(known_tools), "ros2-mcp call lists them.")
                found.append((number, f"There is no tool {tool}. {hint}"))
    mistakes = [Mistake(where, first_line + number, text) for number, text in found]
    return Parsed(prompt, front.line_of("name"), sorted(mistakes, key=lambda mistake: mistake.line))


def _prompt(front: Entry, name: str, body: str) -> Prompt:
    front.check_keys(_PROMPT_KEYS)
    name = front.text("name") or name
    if not _NAME.fullmatch(name):
        raise FrontMatterError(front.line_of("name"), f"{name!r} is no name: letters, digits, dots, - and _ only.")
    if not body.strip():
        raise FrontMatterError(front.line_of("name"), "There is no text after the front matter.")
    arguments = arguments_under(front, "arguments")

    async def write(values: Mapping[str, Any]) -> Sequence[Message]:
        return [Message(template.fill(body, values).strip())]

    return Prompt(name, front.text("title") or name, front.text("description"), arguments, write)
