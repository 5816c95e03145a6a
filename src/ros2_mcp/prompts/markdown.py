"""Prompts from Markdown files: the front matter holds name, description and arguments, the text is the message."""

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
"""The longest file that is read; a longer one would fill the context of a model."""
_PROMPT_KEYS = ("name", "title", "description", "arguments")
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")
_CALL = re.compile(r"\bCall `?(ros2_\w+)")


@dataclass(frozen=True, slots=True)
class Parsed:
    """The result of parsing a file: the prompt, or None if it cannot be used; the line of its name; and the
    mistakes.
    """

    prompt: Prompt | None
    line: int
    mistakes: Sequence[Mistake]


def parse(where: str, name: str, text: str, known_tools: Set[str] = frozenset()) -> Parsed:
    """Parse the text of a file as a prompt.

    Args:
        where: the file, as it is named in mistakes.
        name: the prompt's name if the front matter has none.
        text: the whole file.
        known_tools: all tools; calls of other tools are mistakes. Empty: not checked.
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
        raise FrontMatterError(front.line_of("name"), f"{name!r} is not a name: letters, digits, dots, - and _ only.")
    if not body.strip():
        raise FrontMatterError(front.line_of("name"), "There is no text after the front matter.")
    arguments = arguments_under(front, "arguments")

    async def write(values: Mapping[str, Any]) -> Sequence[Message]:
        return [Message(template.fill(body, values).strip())]

    return Prompt(name, front.text("title") or name, front.text("description"), arguments, write)
