"""Interprets the arguments of a call leniently, since clients and models often fill in every field of a form.

A null always means *not given*. For tools that only read, an empty value that the schema forbids means *not given*,
too, and a number above the maximum means the maximum; the latter is reported. Tools that act accept only what their
schema allows. No tool accepts a number that is not finite.

Where a list of strings or objects is expected, a single one is a list of one, and the reverse; where an object with one
required string is expected, a string stands for it. Both are reported.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any, cast

from ros2_mcp.tools.schema import natural_field

Schema = Mapping[str, Any]
_NUMBERS = ("number", "integer")


def as_meant(schema: Schema, arguments: Mapping[str, Any], *, acts: bool) -> tuple[dict[str, Any], list[str]]:
    """Return the arguments without the arguments that count as not given, and a sentence for each value that was
    changed.

    Args:
        schema: of the arguments, in the plain form of `argument_schema`.
        arguments: as the client sent them.
        acts: whether the tool can change or move something.
    """
    told: list[str] = []
    return _object(schema, arguments, "", acts, told), told


def _object(schema: Schema, values: Mapping[str, Any], path: str, acts: bool, told: list[str]) -> dict[str, Any]:
    properties, required = schema.get("properties", {}), schema.get("required", ())
    taken: dict[str, Any] = {}
    for name, value in values.items():
        node = properties.get(name, {})
        if name in properties and name not in required and _is_nothing(node, value, acts):
            continue
        taken[name] = _value(node, value, f"{path}{name}", acts, told)
    return taken


def _value(node: Schema, value: object, path: str, acts: bool, told: list[str]) -> object:
    value = _one_or_many(node, value, path, told)
    if isinstance(value, dict) and "properties" in node:
        return _object(node, cast("dict[str, object]", value), f"{path}.", acts, told)
    if isinstance(value, list) and "items" in node:
        items = enumerate(cast("list[object]", value))
        return [_value(cast("Schema", node["items"]), item, f"{path}[{index}]", acts, told) for index, item in items]
    return cast("object", value) if acts else _bounded(node, cast("object", value), path, told)


def _one_or_many(node: Schema, value: object, path: str, told: list[str]) -> object:
    """Wrap a single string or object in a list, or unwrap a list of one string, as the schema requires; build an object
    from the one string that it needs."""
    items = cast("Schema", node.get("items", {}) if node.get("type") == "array" else {})
    alone = {"string": (str,), "object": (dict, str) if natural_field(items) else (dict,)}
    kinds = alone.get(str(items.get("type")))
    if kinds and value and isinstance(value, kinds):
        told.append(f"{path}: taken as a list of one.")
        return [cast("object", value)]
    if value and isinstance(value, str) and (name := natural_field(node)):
        told.append(f"{path}: taken as {json.dumps({name: value}, ensure_ascii=False)}.")
        return {name: value}
    if node.get("type") == "string" and isinstance(value, list):
        texts = cast("list[object]", value)
        if len(texts) == 1 and isinstance(texts[0], str):
            told.append(f"{path}: the only element of the list was taken.")
            return texts[0]
    return cast("object", value)


def _bounded(node: Schema, value: object, path: str, told: list[str]) -> object:
    number = _number(value) if node.get("type") in _NUMBERS else None
    if number is None:
        return value
    if number > node.get("maximum", number):
        told.append(f"{path}: {number:g} is above the maximum; {node['maximum']:g} was used.")
        return node["maximum"]
    return number


def _is_nothing(node: Schema, value: object, acts: bool) -> bool:
    """Whether an optional argument counts as not given. A flag of 0 may mean false, so it stays an error."""
    kind = node.get("type")
    if value is None or acts or kind in ("boolean", "object") or isinstance(value, bool):
        return value is None
    if value not in (0, "", "0", []):
        return False
    if kind in _NUMBERS:
        return _number(value) is None or node.get("minimum", 0) > 0 or node.get("exclusiveMinimum", -1) >= 0
    if kind == "array":
        return value != [] or node.get("minItems", 0) > 0
    return value in (0, []) or (value == "" and "enum" in node)


def _number(value: object) -> int | float | None:
    """Return a finite number, also from a string, as some clients send all fields of a form; None for anything else."""
    if isinstance(value, str):
        try:
            value = json.loads(value)
        except (ValueError, RecursionError):
            return None
    if not isinstance(value, (int, float)) or isinstance(value, bool):
        return None
    try:
        return value if math.isfinite(value) else None
    except OverflowError:  # an integer beyond the largest floating-point number
        return None
