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
"""Of a file; a longer one is no prompt but was put there by mistake, and would fill a model's memory."""
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
    declared = {argument.name for argument in prompt.arguments}
    found = [*template.mistakes_of(body, declared), *_unknown_tools(body, known_tools)]
    mistakes = [Mistake(where, first_line + number, text) for number, text in found]
    return Parsed(prompt, front.line_of("name"), sorted(mistakes, key=lambda mistake: mistake.line))


def _prompt(front: Entry, name: str, body: str) -> Prompt:
    _only_known_keys(front, _PROMPT_KEYS)
    name = front.text("name") or name
    if not _NAME.fullmatch(name):
        raise FrontMatterError(front.line_of("name"), f"{name!r} is no name: letters, digits, dots, - and _ only.")
    if not body.strip():
        raise FrontMatterError(front.line_of("name"), "There is no text after the front matter.")
    arguments = [_argument(entry) for entry in front.entries("arguments")]
    _no_argument_twice(front, arguments)

    async def write(values: Mapping[str, Any]) -> Sequence[Message]:
        return [Message(template.fill(body, values).strip())]

    return Prompt(name, front.text("title") or name, front.text("description"), arguments, write)


def _argument(entry: Entry) -> Argument:
    _only_known_keys(entry, _ARGUMENT_KEYS)
    name = entry.text("name")
    if not _ARGUMENT_NAME.fullmatch(name):
        raise FrontMatterError(entry.line_of("name"), f"{name!r} is no name for an argument: letters, digits, _ only.")
    kind = entry.text("type") or "string"
    if kind not in KINDS:
        known = ", ".join(KINDS)
        raise FrontMatterError(
            entry.line_of("type"), f"{kind!r} is no type. {did_you_mean(kind, list(KINDS), f'Choose from: {known}.')}"
        )
    bare = Argument(
        name,
        entry.text("description"),
        kind,
        required=entry.flag("required"),
        minimum=entry.number("minimum", -math.inf),
        maximum=entry.number("maximum", math.inf),
    )
    chosen = replace(bare, choices=_values(bare, entry, "choices", entry.texts("choices")))
    if entry.is_list("default"):
        default = [json.dumps(entry.texts("default"))]
    else:
        default = [entry.text("default")] if entry.text("default") else []
    return replace(chosen, default=next(iter(_values(chosen, entry, "default", default)), None))


def _values(argument: Argument, entry: Entry, key: str, texts: Sequence[str]) -> Sequence[Any]:
    """The values under a key, each checked like what a client gives."""
    try:
        return [argument.value(text) for text in texts]
    except BadInput as error:
        raise FrontMatterError(entry.line_of(key), f"{key}: {error}") from None


def _only_known_keys(entry: Entry, known: Sequence[str]) -> None:
    for key in entry.nodes:
        if key not in known:
            hint = did_you_mean(key, known, f"Known are: {', '.join(known)}.")
            raise FrontMatterError(entry.line_of(key), f"{key!r} means nothing here. {hint}")


def _no_argument_twice(front: Entry, arguments: Sequence[Argument]) -> None:
    seen: set[str] = set()
    for argument, entry in zip(arguments, front.entries("arguments"), strict=True):
        if argument.name in seen:
            raise FrontMatterError(entry.line_of("name"), f"The argument {argument.name} is there twice.")
        seen.add(argument.name)


def _unknown_tools(body: str, known: Set[str]) -> list[tuple[int, str]]:
    if not known:
        return []
    return [
        (number, f"There is no tool {tool}. {did_you_mean(tool, sorted(known), 'ros2-mcp call lists them.')}")
        for number, line in enumerate(body.split("\n"))
        for tool in _CALL.findall(line)
        if tool not in known
    ]
