"""Prompts out of Markdown files: the front matter says name, description and arguments, the text is the message."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace
from typing import Any

from ros2_mcp.model.errors import BadInput
from ros2_mcp.model.names import did_you_mean
from ros2_mcp.prompts import template
from ros2_mcp.prompts.arguments import KINDS, Argument
from ros2_mcp.prompts.front_matter import Entry, FrontMatterError, split
from ros2_mcp.prompts.mistakes import Mistake
from ros2_mcp.prompts.prompt import Message, Prompt

MAX_CHARACTERS = 100_000
"""The longest file that is read; a longer one is no prompt, and would fill a model's context."""
_PROMPT_KEYS = ("name", "title", "description", "arguments")
_ARGUMENT_KEYS = ("name", "description", "type", "required", "default", "choices", "minimum", "maximum")
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")
_ARGUMENT_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,63}")
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
    arguments: dict[str, Argument] = {}
    for entry in front.entries("arguments"):
        argument = _argument(entry)
        if argument.name in arguments:
            raise FrontMatterError(entry.line_of("name"), f"The argument {argument.name} is there twice.")
        arguments[argument.name] = argument

    async def write(values: Mapping[str, Any]) -> Sequence[Message]:
        return [Message(template.fill(body, values).strip())]

    return Prompt(name, front.text("title") or name, front.text("description"), list(arguments.values()), write)


def _argument(entry: Entry) -> Argument:
    entry.check_keys(_ARGUMENT_KEYS)
    name, kind = entry.text("name"), entry.text("type") or "string"
    if not _ARGUMENT_NAME.fullmatch(name):
        raise FrontMatterError(entry.line_of("name"), f"{name!r} is no name for an argument: letters, digits, _ only.")
    if kind not in KINDS:
        hint = did_you_mean(kind, list(KINDS), f"Choose from: {', '.join(KINDS)}.")
        raise FrontMatterError(entry.line_of("type"), f"{kind!r} is no type. {hint}")
    argument = Argument(
        name,
        entry.text("description"),
        kind,
        required=entry.flag("required"),
        minimum=entry.number("minimum", -math.inf),
        maximum=entry.number("maximum", math.inf),
    )
    argument = replace(argument, choices=_values(argument, entry, "choices", entry.texts("choices")))
    default = json.dumps(entry.texts("default")) if entry.is_list("default") else entry.text("default")
    values = _values(argument, entry, "default", [default] if default else [])
    return replace(argument, default=values[0] if values else None)


def _values(argument: Argument, entry: Entry, key: str, texts: Sequence[str]) -> Sequence[Any]:
    """The values of the texts under a key, each checked like what a client gives."""
    try:
        return [argument.value(text) for text in texts]
    except BadInput as error:
        raise FrontMatterError(entry.line_of(key), f"{key}: {error}") from None
