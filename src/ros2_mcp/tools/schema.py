"""JSON schemas in the plain form that every MCP client accepts: without references, unions and titles; objects are
closed."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from types import NoneType
from typing import Any, Literal, cast, get_args, get_origin, get_type_hints

from ros2_mcp.ops.results.results import may_be_absent

Schema = dict[str, Any]
_REFERENCE = "#/$defs/"
# Bounds of a number: pydantic's name → name in JSON schema.
_BOUNDS = {"ge": "minimum", "gt": "exclusiveMinimum", "le": "maximum", "lt": "exclusiveMaximum"}
_SCALARS: Mapping[Any, str] = {str: "string", bool: "boolean", int: "integer", float: "number"}
_IN_SECONDS = re.compile("timeout|duration|^wait_")
"""Matches names of arguments that are a duration or a time to wait."""
_KINDS: Mapping[Any, str] = {
    "string": "a text",
    "boolean": "true or false",
    "array": "a list",
    "object": "an object",
}
_NULL: Schema = {"type": "null"}
_ANY_SCALAR: list[Schema] = [{"type": "boolean"}, {"type": "number"}, {"type": "string"}]
# A value whose type is known only at run time, such as that of a parameter. Some clients reject a schema without a
# type, others one with a list of types, so each branch has one type.
_ANY_VALUE: Schema = {"anyOf": [*_ANY_SCALAR, {"type": "array", "items": {"anyOf": _ANY_SCALAR}}, _NULL]}


def argument_schema(schema: Mapping[str, Any]) -> Schema:
    """Return the schema of a tool's arguments: optional values appear as plain values, and unknown arguments are
    errors.
    """
    result = _plain(schema, schema.get("$defs", {}))
    result["additionalProperties"] = False
    for name, node in result.setdefault("properties", {}).items():
        if _IN_SECONDS.search(name) and node.get("type") != "boolean":
            node["description"] = _with_bounds(node)
    return result


def _with_bounds(node: Mapping[str, Any]) -> str:
    """Return the description with default and maximum in words: some clients drop these keywords, and a model must know
    how long a call may take."""
    said = [f"default {node['default']:g}"] if "default" in node else []
    said += [f"at most {node['maximum']:g}"] if "maximum" in node else []
    words = ", ".join(said)
    return f"{node['description']} {words[0].upper()}{words[1:]}." if words else node["description"]


def result_schema(kind: Any) -> Schema:
    """Return the schema of a result: dataclasses of plain values. Fields are required unless they may be absent when
    empty; a value that may be null has null as an alternative."""
    options = get_args(kind)
    if NoneType in options:
        (present,) = (option for option in options if option is not NoneType)
        return {"anyOf": [result_schema(present), _NULL]}
    if get_origin(kind) is Literal:
        return {"type": _SCALARS[type(options[0])], "enum": list(options)}
    if is_dataclass(kind):
        hints = get_type_hints(kind)
        shown = [field for field in fields(kind) if not field.metadata.get("hidden")]
        properties = {field.name: result_schema(hints[field.name]) for field in shown}
        always = [field.name for field in shown if not may_be_absent(field)]
        return {"type": "object", "properties": properties, "required": always}
    origin = get_origin(kind) or kind
    if origin in (list, tuple, Sequence):
        return {"type": "array", "items": result_schema(options[0])}
    if origin in (dict, Mapping):
        return {"type": "object", "additionalProperties": True}
    return {"type": _SCALARS[origin]} if origin in _SCALARS else dict(_ANY_VALUE)


def node_at(schema: Mapping[str, Any], path: Sequence[str | int]) -> Mapping[str, Any]:
    """Return the part of a schema at a path of names and indices; empty if there is none."""
    for part in path:
        if isinstance(part, int):
            schema = schema.get("items", {})
        else:
            others = schema.get("additionalProperties")
            schema = schema.get("properties", {}).get(part, others if isinstance(others, dict) else {})
    return schema


def expected_kind(node: Mapping[str, Any]) -> str:
    """Describe what a part of a schema accepts: "a whole number of at least 1 and at most 2000"; "" if it accepts
    anything."""
    kind = node.get("type")
    if "enum" in node:
        return f"one of {', '.join(map(str, node['enum']))}"
    if kind in ("number", "integer"):
        bounds = ((" of at least", "minimum"), (" above", "exclusiveMinimum"), (" at most", "maximum"))
        said = [f"{words} {node[key]:g}" for words, key in bounds if key in node]
        return ("a whole number" if kind == "integer" else "a finite number") + " and".join(said)
    least, most, of = {
        "array": ("minItems", "maxItems", " elements"),
        "string": ("minLength", "maxLength", " characters"),
    }.get(str(kind), ("", "", ""))
    said = [f"{words} {node[key]}" for words, key in (("at least", least), ("at most", most)) if node.get(key)]
    sized = f" of {' and '.join(said)}{of}" if said else ""
    sized += f" like {node['pattern']}" if kind == "string" and "pattern" in node else ""
    needed = node.get("required", ()) if kind == "object" else ()
    form = f" such as {{{', '.join(f'{json.dumps(name)}: …' for name in needed)}}}" if needed else ""
    return f"{_KINDS[kind]}{sized}{form}" if kind in _KINDS else ""


def natural_field(node: Mapping[str, Any]) -> str:
    """Return the field of an object that a string alone can stand for: its only required field, if that is a string;
    else ""."""
    needed = node.get("required", ()) if node.get("type") == "object" else ()
    if len(needed) != 1 or node["properties"][needed[0]].get("type") != "string":
        return ""
    return str(needed[0])


def text_for_number(schema: Mapping[str, Any], value: Any, path: str = "") -> str:
    """Return the path of a string where the schema expects a number, in `value` or anything inside it; "" if there is
    none."""
    if isinstance(value, str):
        return path if schema.get("type") in ("number", "integer") else ""
    below: Iterable[tuple[str, Any, Any]] = ()
    if isinstance(value, list):
        items = enumerate(cast("list[Any]", value))
        below = ((f"{path}[{index}]", schema.get("items"), item) for index, item in items)
    elif isinstance(value, dict):
        properties, others = schema.get("properties", {}), schema.get("additionalProperties")
        below = (
            (f"{path}.{name}" if path else name, properties.get(name, others), inner)
            for name, inner in cast("dict[str, Any]", value).items()
        )
    found = (text_for_number(cast("Schema", part), inner, at) for at, part, inner in below if isinstance(part, dict))
    return next(filter(None, found), "")


def _plain(node: Mapping[str, Any], definitions: Mapping[str, Any]) -> Schema:
    """Return the schema with references resolved, without parts that cost the model tokens and add nothing: titles, and
    defaults null and "", which mean *not given*."""
    if "$ref" in node:
        target = definitions[str(node["$ref"]).removeprefix(_REFERENCE)]
        return _plain({**target, **_without(node, "$ref")}, definitions)
    if "anyOf" in node:
        return _optional(node, definitions)
    result: Schema = {}
    for key, value in node.items():
        if key == "properties":
            result[key] = {name: _plain(part, definitions) for name, part in value.items()}
        elif key == "items":
            result[key] = _plain(value, definitions)
        elif key not in ("$defs", "title") and (key != "default" or value not in (None, "")):
            result[_BOUNDS.get(key, key)] = value
    if result.get("type") == "object" and "properties" not in result:
        result.setdefault("additionalProperties", True)
    return result


def _optional(node: Mapping[str, Any], definitions: Mapping[str, Any]) -> Schema:
    """Return the schema of `X | None` as plain X; raises `TypeError` for any other union, which some clients reject."""
    options = cast("list[Schema]", node["anyOf"])
    present = [option for option in options if option.get("type") != "null"]
    if len(present) != 1 or len(options) != 2:
        raise TypeError(f"a tool's schema has a union that not every client accepts: {node}")
    return _plain({**present[0], **_without(node, "anyOf")}, definitions)


def _without(node: Mapping[str, Any], key: str) -> Schema:
    return {name: value for name, value in node.items() if name != key}
