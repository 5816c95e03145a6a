"""Arguments that a file declares in its front matter: the arguments of a prompt, and the inputs of a kept program."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from ros2_mcp.model.arguments import KINDS, Argument
from ros2_mcp.model.errors import BadInput
from ros2_mcp.model.front_matter import Entry, FrontMatterError
from ros2_mcp.model.names import did_you_mean

_KEYS = ("name", "description", "type", "required", "default", "choices", "minimum", "maximum")
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,63}")


def arguments_under(front: Entry, key: str) -> list[Argument]:
    """Return the arguments in the list under a key, in order; raises `FrontMatterError` with the line of a mistake."""
    found: dict[str, Argument] = {}
    for entry in front.entries(key):
        argument = argument_of(entry)
        if argument.name in found:
            raise FrontMatterError(entry.line_of("name"), f"The argument {argument.name} is given twice.")
        found[argument.name] = argument
    return list(found.values())


def argument_of(entry: Entry) -> Argument:
    """Return the argument that an entry declares; raises `FrontMatterError` with the line of a mistake."""
    entry.check_keys(_KEYS)
    name, kind = entry.text("name"), entry.text("type") or "string"
    if not _NAME.fullmatch(name):
        raise FrontMatterError(entry.line_of("name"), f"{name!r} is not an argument name: letters, digits, _ only.")
    if kind not in KINDS:
        hint = did_you_mean(kind, list(KINDS), f"Choose from: {', '.join(KINDS)}.")
        raise FrontMatterError(entry.line_of("type"), f"{kind!r} is not a type. {hint}")
    argument = Argument(
        name,
        entry.text("description"),
        kind,
        required=entry.flag("required"),
        minimum=entry.number("minimum", -math.inf),
        maximum=entry.number("maximum", math.inf),
    )
    argument = replace(argument, choices=_values(argument, entry, "choices", entry.texts("choices")))
    is_list = entry.is_list("default") and kind != "json"  # a JSON list, whose elements `texts` would turn into strings
    default = json.dumps(entry.texts("default")) if is_list else entry.text("default")
    values = _values(argument, entry, "default", [default] if default else [])
    return replace(argument, default=values[0] if values else None)


def _values(argument: Argument, entry: Entry, key: str, texts: Sequence[str]) -> Sequence[Any]:
    """Parse the texts under a key, each like a value from a client."""
    try:
        return tuple(argument.value(text) for text in texts)
    except BadInput as error:
        raise FrontMatterError(entry.line_of(key), f"{key}: {error}") from None
