"""Texts with placeholders.

`{{name}}` is replaced by the argument's value, `{{name|json}}` by its value as JSON. Lines between `{{#if name}}` (or
`{{#if not name}}`) and `{{/if}}`, each on a line of its own, are kept only if the value is true (or false). All other
braces are kept.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Set
from typing import Any

from ros2_mcp.model.arguments import shown
from ros2_mcp.model.names import did_you_mean

_PLACEHOLDER = re.compile(r"\{\{[ \t]*(?P<name>[A-Za-z_]\w*)[ \t]*(?:\|[ \t]*(?P<json>json)[ \t]*)?\}\}")
_IF = re.compile(r"^\s*\{\{#if (?P<no>not )?\s*(?P<name>[A-Za-z_]\w*)\s*\}\}\s*$")
_END = re.compile(r"^\s*\{\{/if\s*\}\}\s*$")


def fill(text: str, values: Mapping[str, Any]) -> str:
    """Return the text with its placeholders replaced and its `{{#if}}` blocks applied, once: placeholders within a
    value are kept.
    """

    def value_of(found: re.Match[str]) -> str:
        if found["name"] not in values:
            return found[0]
        value = values[found["name"]]
        return json.dumps(value, ensure_ascii=False) if found["json"] else shown(value)

    lines: list[str] = []
    conditions: list[bool] = []
    for line in text.split("\n"):
        if (begin := _IF.match(line)) and begin["name"] in values:
            conditions.append(bool(values[begin["name"]]) != bool(begin["no"]))
        elif conditions and _END.match(line):
            conditions.pop()
        elif all(conditions):
            lines.append(_PLACEHOLDER.sub(value_of, line))
    return "\n".join(lines)


def mistakes_of(text: str, arguments: Set[str]) -> Iterator[tuple[int, str]]:
    """Yield the mistakes in a text, each with its line, counted from 0."""
    open_since: list[int] = []
    for number, line in enumerate(text.split("\n")):
        used = [found["name"] for found in _PLACEHOLDER.finditer(line)]
        if begin := _IF.match(line):
            open_since.append(number)
            used.insert(0, begin["name"])
        elif _END.match(line):
            if not open_since:
                yield number, "{{/if}} without {{#if}}."
            else:
                open_since.pop()
        for name in used:
            if name not in arguments:
                hint = did_you_mean(name, sorted(arguments), "Declare it, or it stays as written.")
                yield number, f"There is no argument {name}. {hint}"
    yield from ((number, "{{#if}} is never closed with {{/if}}.") for number in open_since)
