"""Reads `key=value` words of a command line as a tool's arguments, by the types that the tool declares."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Mapping, Sequence
from typing import Any

from ros2_mcp.model.errors import BadInput
from ros2_mcp.tools.misnamed import hint_for

Schema = Mapping[str, Any]

_QUOTED = r"\"[^\"]*\"|'[^']*'"
_PART = re.compile(rf"(?:{_QUOTED}|\[(?:{_QUOTED}|[^\]\"'])*\]|[^,])+")
"""The text between two commas; commas in brackets or quotes belong to it."""

_EXAMPLES: Mapping[str, Any] = {"string": "text", "number": 2.5, "integer": 5, "boolean": True}
_KINDS = {
    "number": "a number",
    "integer": "a whole number",
    "boolean": "true or false",
    "array": "a list",
    "object": "an object of JSON",
}


def read_assignments(assignments: Sequence[str], schema: Schema, aliases: Mapping[str, str]) -> dict[str, Any]:
    """Return the arguments of a tool.

    For a string, any text is accepted, such as `5` or `true`. For a list, one value is a list of one, and commas
    separate several. All other values are JSON.

    Raises:
        BadInput: with an example of how to write the argument.
    """
    known: Mapping[str, Schema] = schema["properties"]
    arguments: dict[str, Any] = {}
    spelled: dict[str, str] = {}
    for word in assignments:
        name, equals, text = word.partition("=")
        own_name = aliases.get(name, name)
        if not equals:
            one = next(iter(known), "")
            hint = f"Write argument=value, such as {written(one, known[one])}." if one else "It takes no arguments."
            raise BadInput(f"{word!r} is not an assignment.", hint)
        if own_name not in known:
            raise BadInput(f"It has no argument {name!r}.", hint_for(name, list(known)))
        if (other := spelled.setdefault(own_name, name)) != name or name in arguments:
            raise BadInput(f"{other!r} and {name!r} are one argument, which is given twice.", "Give it once.")
        arguments[name] = _read(name, text, known[own_name])
    given = spelled.keys()
    if missing := [name for name in schema.get("required", ()) if name not in given]:
        hint = f"Write: {' '.join(written(name, known[name]) for name in missing)}"
        raise BadInput(f"It needs the argument {', '.join(map(repr, missing))}.", hint)
    return arguments


def written(name: str, schema: Schema) -> str:
    """Return an argument with an example value, as it is typed into a shell."""
    example = _example(name, schema)
    text = example if isinstance(example, str) else json.dumps(example, ensure_ascii=False)
    return shlex.quote(f"{name}={text}")


def _read(name: str, text: str, schema: Schema) -> Any:
    kind = schema.get("type", "")
    try:
        value: Any = json.loads(text)
    except ValueError:
        value = text
    if kind == "string":
        return value if isinstance(value, str) else text
    if value is None or _fits(value, kind):
        return value
    if kind == "array":
        return _one_or_several(name, value if isinstance(value, dict) else text, schema)
    raise _unreadable(name, text, schema)


def _one_or_several(name: str, value: Any, schema: Schema) -> list[Any]:
    """Return the list that a value means, where a list is expected."""
    items: Schema = schema["items"]
    if items.get("type") == "object":
        needed: list[str] = items.get("required", [])
        if isinstance(value, dict):
            return [value]
        if len(needed) == 1 and value[:1] not in ("{", "["):
            return [{needed[0]: one} for one in _PART.findall(value)]
    elif isinstance(value, str) and value[:1] not in ("{", "["):
        return [_read(name, one, items) for one in _PART.findall(value)]
    raise _unreadable(name, value, schema)


def _fits(value: Any, kind: str) -> bool:
    if kind in ("number", "integer"):
        return isinstance(value, int if kind == "integer" else (int, float)) and not isinstance(value, bool)
    return isinstance(value, {"boolean": bool, "object": dict, "array": list}.get(kind, object))


def _unreadable(name: str, text: Any, schema: Schema) -> BadInput:
    shown = text if isinstance(text, str) else json.dumps(text)
    kind = _KINDS.get(schema.get("type", ""), "JSON")
    return BadInput(f"{name}: {shown!r} is not {kind}.", f"Write: {written(name, schema)}")


def _example(name: str, schema: Schema) -> Any:
    """Return the example in the description of an argument, or else a value of its type."""
    kind = schema.get("type", "string")
    if found := re.search(r"[Ss]uch as (\[.*?\](?=[.,;) ]|$)|\{.*\})", schema.get("description", "")):
        try:
            if _fits(example := json.loads(found[1]), kind):
                return example
        except ValueError:
            pass  # not JSON
    if kind == "string" and (found := re.search(r"[Ss]uch as (\w*/[\w/]+)", schema.get("description", ""))):
        return found[1]
    if choices := schema.get("enum"):
        return choices[0]
    if kind == "array":
        return [_example(name.removesuffix("s"), schema["items"])]
    if kind == "object":
        known: Mapping[str, Schema] = schema.get("properties", {})
        return {one: _example(one, known[one]) for one in schema.get("required", known)} or {"x": 0.5}
    if kind == "string" and "topic" in name:
        return "/odom"
    return schema.get("default") or _EXAMPLES.get(kind, "text")
