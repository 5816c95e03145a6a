"""Texts with placeholders.

`{{name}}` becomes the argument's value and `{{name|json}}` its value as JSON; lines between `{{#if name}}` (or
`{{#if not name}}`) and `{{/if}}`, each alone on its line, stay only if the value says so. Every other brace stays as
it is.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from typing import Any

from ros2_mcp.model.names import did_you_mean
from ros2_mcp.prompts.arguments import shown

_PLACEHOLDER = re.compile(r"\{\{[ \t]*(?P<name>[A-Za-z_]\w*)[ \t]*(?:\|[ \t]*(?P<json>json)[ \t]*)?\}\}")
_IF = re.compile(r"^\s*\{\{#if (?P<no>not )?\s*(?P<name>[A-Za-z_]\w*)\s*\}\}\s*$")
_END = re.compile(r"^\s*\{\{/if\s*\}\}\s*$")


def fill(text: str, values: Mapping[str, Any]) -> str:
    """The text with its placeholders replaced, once: what a value brings along is not looked at again."""
    return "\n".join(_PLACEHOLDER.sub(_replaced(values), line) for line in _kept(text.split("\n"), values))


def _replaced(values: Mapping[str, Any]) -> Callable[[re.Match[str]], str]:
    def value_of(found: re.Match[str]) -> str:
        if found["name"] not in values:
            return found[0]
        value = values[found["name"]]
        return json.dumps(value, ensure_ascii=False) if found["json"] else shown(value)

    return value_of


def _kept(lines: Sequence[str], values: Mapping[str, Any]) -> Iterator[str]:
    """The lines that no condition leaves out."""
    conditions: list[bool] = []
    for line in lines:
        if (begin := _IF.match(line)) and begin["name"] in values:
            conditions.append(bool(values[begin["name"]]) != bool(begin["no"]))
        elif conditions and _END.match(line):
            conditions.pop()
        elif all(conditions):
            yield line


def mistakes_of(text: str, known: Set[str]) -> Iterator[tuple[int, str]]:
    """What is wrong in a text, each with its line, counted from 0."""
    open_since: list[int] = []
    for number, line in enumerate(text.split("\n")):
        if begin := _IF.match(line):
            open_since.append(number)
            if begin["name"] not in known:
                yield number, _undeclared(begin["name"], known)
        elif _END.match(line):
            if not open_since:
                yield number, "{{/if}} without {{#if}}."
            else:
                open_since.pop()
        for found in _PLACEHOLDER.finditer(line):
            if found["name"] not in known:
                yield number, _undeclared(found["name"], known)
    yield from ((number, "{{#if}} is never closed with {{/if}}.") for number in open_since)


def _undeclared(name: str, known: Set[str]) -> str:
    return f"There is no argument {name}. {did_you_mean(name, sorted(known), 'Declare it, or it stays as written.')}"
