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
    shape = field.shape
    if field.default is not None:
        return _default(field)
    if shape.shape == "single":
        return _element(structure_of, shape)
    length = shape.size if shape.shape == "array" else 0
    if shape.is_message or shape.base in TEXTS:
        return [_element(structure_of, shape) for _ in range(length)]
    return json_numbers(shape, zeros(shape.base, length))


def _default(field: Field) -> Any:
    default, base = field.default, field.shape.base
    if isinstance(default, (list, tuple)):
        return list(default) if base in TEXTS else json_numbers(field.shape, numbers(field.shape, default, field.name))
    return default if base in TEXTS else json_number(base, default)


def _element(structure_of: Callable[[str], Structure], shape: FieldType) -> Any:
    if shape.is_message:
        return example_of(structure_of, shape.base)
    return "" if shape.base in TEXTS else zeros(shape.base, 1)[0].item()
