"""Example values, ready to fill in."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ros2_mcp.codec.scalars import numbers, zeros
from ros2_mcp.codec.summary import json_number, json_numbers
from ros2_mcp.model.interfaces import TEXTS, Field, FieldType, Structure


def example_of(structure_of: Callable[[str], Structure], type_name: str) -> dict[str, Any]:
    """A JSON value with every field at its default, else zero; sequences are empty, arrays have their length."""
    return {field.name: _value(structure_of, field) for field in structure_of(type_name).fields}


def _value(structure_of: Callable[[str], Structure], field: Field) -> Any:
    field_type = field.type
    if field.default is not None:
        return _default(field)
    if field_type.arity == "single":
        return _element(structure_of, field_type)
    length = field_type.size if field_type.arity == "array" else 0
    if field_type.is_message or field_type.base in TEXTS:
        return [_element(structure_of, field_type) for _ in range(length)]
    return json_numbers(field_type, zeros(field_type.base, length))


def _default(field: Field) -> Any:
    default, base = field.default, field.type.base
    if isinstance(default, (list, tuple)):
        return list(default) if base in TEXTS else json_numbers(field.type, numbers(field.type, default, field.name))
    return default if base in TEXTS else json_number(base, default)


def _element(structure_of: Callable[[str], Structure], field_type: FieldType) -> Any:
    if field_type.is_message:
        return example_of(structure_of, field_type.base)
    return "" if field_type.base in TEXTS else zeros(field_type.base, 1)[0].item()
