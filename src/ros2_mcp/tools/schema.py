"""JSON schemas in the plain form that every MCP client accepts: no references, no unions, no titles, closed objects."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

Schema = dict[str, Any]
_REFERENCE = "#/$defs/"
_BOUNDS = {"ge": "minimum", "gt": "exclusiveMinimum", "le": "maximum", "lt": "exclusiveMaximum"}
_ANY_VALUE: Schema = {
    "type": ["boolean", "number", "string", "array", "null"],
    "items": {"type": ["boolean", "number", "string"]},
}


def plain_input(schema: Mapping[str, Any]) -> Schema:
    """A schema of arguments: optional values are shown as plain ones, unknown arguments are errors."""
    result = _plain(schema, schema.get("$defs", {}), nullable=False)
    result["additionalProperties"] = False
    result.setdefault("properties", {})
    return result


def plain_output(schema: Mapping[str, Any]) -> Schema:
    """A schema of a result: what may be null says so, because clients validate it."""
    return _plain(schema, schema.get("$defs", {}), nullable=True)


def _plain(node: Mapping[str, Any], definitions: Mapping[str, Any], *, nullable: bool) -> Schema:
    if "$ref" in node:
        target = definitions[str(node["$ref"]).removeprefix(_REFERENCE)]
        return _plain({**target, **_without(node, "$ref")}, definitions, nullable=nullable)
    if not node.keys() - {"title", "default", "description"}:
        return {**_ANY_VALUE, **_without(node, "title")}
    if "anyOf" in node:
        return _optional(node, definitions, nullable=nullable)
    result: Schema = {}
    for key, value in node.items():
        if key == "properties":
            result[key] = {name: _plain(part, definitions, nullable=nullable) for name, part in value.items()}
        elif key == "items":
            result[key] = _plain(value, definitions, nullable=nullable)
        elif not _is_noise(key, value, node, nullable=nullable):
            result[_BOUNDS.get(key, key)] = value
    if result.get("type") == "object" and "properties" not in result:
        result.setdefault("additionalProperties", True)
    return result


def _is_noise(key: str, value: Any, node: Mapping[str, Any], *, nullable: bool) -> bool:
    """What clients do not need: titles, null defaults, and docstrings of the classes that results are made of."""
    is_docstring = key == "description" and nullable and "properties" in node
    return key in ("$defs", "title") or (key == "default" and value is None) or is_docstring


def _optional(node: Mapping[str, Any], definitions: Mapping[str, Any], *, nullable: bool) -> Schema:
    """`X | None`: plain X in inputs, a nullable X in outputs. No other union is ever declared."""
    options = cast("list[Schema]", node["anyOf"])
    present = [option for option in options if option.get("type") != "null"]
    if len(present) != 1 or len(options) != 2:
        raise TypeError(f"a tool's schema has a union that not every client accepts: {node}")
    inner = _plain({**present[0], **_without(node, "anyOf")}, definitions, nullable=nullable)
    if nullable and isinstance(inner.get("type"), str):
        inner["type"] = [inner["type"], "null"]
    return inner


def _without(node: Mapping[str, Any], key: str) -> Schema:
    return {name: value for name, value in node.items() if name != key}
