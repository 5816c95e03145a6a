"""Structured content as tests read it: a field that is left out because it is empty reads as the empty value."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

from ros2_mcp.mcp.binding import answer_schema
from ros2_mcp.mcp.server import STRUCTURED
from ros2_mcp.tools import TOOLS

META: dict[str, Any] = {STRUCTURED: True}
"""The `_meta` of a request that asks for structured content, or in `tools/list` for output schemas."""


class Structured(dict[str, Any]):
    """One object; `[]` gives of a field that its schema has and that is absent the empty value of its type."""

    def __init__(self, value: Mapping[str, Any], schema: Mapping[str, Any]) -> None:
        self._properties: Mapping[str, Any] = schema.get("properties", {})
        super().__init__({name: read(part, self._properties.get(name, {})) for name, part in value.items()})

    def __eq__(self, other: object) -> bool:
        """As a dictionary, but that an empty field may be absent."""
        if not isinstance(other, dict):
            return NotImplemented
        absent = {name: self[name] for name in other if name not in self and name in self._properties}
        return {**self, **absent} == other

    __hash__ = None  # type: ignore[assignment]

    def __missing__(self, name: str) -> Any:
        if name not in self._properties:
            raise KeyError(name)
        kind = self._properties[name].get("type")
        return {"string": "", "array": [], "object": {}}.get(kind)


def result_of(tool: str, result: Mapping[str, Any]) -> Any:
    """The structured content in the result of a call, as the tool declares it."""
    return read(result["structuredContent"], _schemas()[tool])


@cache
def _schemas() -> dict[str, Any]:
    return {tool.name: answer_schema(tool.signature().return_annotation) for tool in TOOLS}


def read(value: Any, schema: Mapping[str, Any]) -> Any:
    """A value of structured content, of which the objects are `Structured` where their schema names fields."""
    if isinstance(value, dict):
        for part in schema.get("anyOf", [schema]):
            if "properties" in part:
                return Structured(value, part)
        return value
    if isinstance(value, list):
        items = schema.get("items", {})
        return [read(item, items) for item in value]
    return value
