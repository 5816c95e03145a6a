"""JSON → message objects, strictly: what does not fit its definition is refused, naming the path."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from ros2_mcp.codec.definitions import Definitions
from ros2_mcp.codec.scalars import is_summary, numbers, octets, scalar, summary_error, zeros
from ros2_mcp.codec.text import excerpt
from ros2_mcp.model.errors import BadValue
from ros2_mcp.model.interfaces import OCTETS, TEXTS, Field, FieldType, Structure
from ros2_mcp.model.names import nearest


def check(definitions: Definitions, type_name: str, value: object, *, partial: bool = True) -> object:
    """The message that a JSON value describes.

    Fields that are missing take the default of the definition, else zero; with `partial=False` none may be missing.
    Accepted beside the plain JSON kinds: `"nan"`, `"inf"`, `"-inf"` for floating-point numbers; decimal strings for
    64-bit integers; base64 or a list for bytes; integers for floats and integral floats for integers where exact.

    Raises:
        BadValue: for anything else.
        UnknownInterface: if there is no definition of the type.
    """
    return _Check(definitions, partial).message(type_name, value, "")


def missing_fields(definitions: Definitions, type_name: str, value: object) -> list[str]:
    """The top-level fields that the value does not give."""
    given = _object(definitions.structure(type_name), value, "")
    return [field.name for field in definitions.structure(type_name).fields if field.name not in given]


class _Check:
    def __init__(self, definitions: Definitions, partial: bool) -> None:
        self._definitions = definitions
        self._partial = partial

    def message(self, type_name: str, value: object, path: str) -> object:
        structure = self._definitions.structure(type_name)
        given = _object(structure, value, path)
        values = [
            self._value(field.type, given[field.name], _below(path, field.name))
            if field.name in given
            else self._missing(field, path)
            for field in structure.fields
        ]
        return self._definitions.message_class(type_name)(*values)

    def _missing(self, field: Field, path: str) -> Any:
        if not self._partial:
            raise BadValue(_below(path, field.name), f"is missing, {field.type} expected.")
        if field.default is not None:
            return self._value(field.type, field.default, _below(path, field.name))
        return self._zero(field.type)

    def _zero(self, field_type: FieldType) -> Any:
        if field_type.arity == "single":
            return self._zero_element(field_type)
        length = field_type.size if field_type.arity == "array" else 0
        if field_type.is_message or field_type.base in TEXTS:
            return [self._zero_element(field_type) for _ in range(length)]
        return zeros(field_type.base, length)

    def _zero_element(self, field_type: FieldType) -> Any:
        if field_type.is_message:
            return self.message(field_type.base, {}, "")
        return "" if field_type.base in TEXTS else zeros(field_type.base, 1)[0].item()

    def _value(self, field_type: FieldType, value: object, path: str) -> Any:
        if field_type.arity != "single":
            return self._several(field_type, value, path)
        if field_type.is_message:
            return self.message(field_type.base, value, path)
        return scalar(field_type, value, path)

    def _several(self, field_type: FieldType, value: object, path: str) -> list[Any] | NDArray[Any]:
        if field_type.base in OCTETS and isinstance(value, str):
            data = octets(value, path)
            _check_length(field_type, len(data), path)
            return data
        values = _list(field_type, value, path)
        _check_length(field_type, len(values), path)
        if field_type.is_message or field_type.base in TEXTS:
            return [self._value(field_type.element, item, f"{path}[{index}]") for index, item in enumerate(values)]
        return numbers(field_type, values, path)


def _object(structure: Structure, value: object, path: str) -> Mapping[str, object]:
    if is_summary(value):
        raise summary_error(path)
    if not isinstance(value, Mapping):
        raise BadValue(path, f"{excerpt(value)} given, an object with the fields of {structure.type} expected.")
    given = cast("Mapping[str, object]", value)
    known = [field.name for field in structure.fields]
    for name in given:
        if name not in known:
            raise _unknown_field(structure, name, known, path)
    return given


def _unknown_field(structure: Structure, name: str, known: Sequence[str], path: str) -> BadValue:
    near = nearest(str(name), known)
    hint = f"Did you mean {near}? " if near else ""
    fields = f"Its fields are {', '.join(known)}." if known else "It has no fields."
    return BadValue(_below(path, str(name)[:80]), f"{structure.type} has no such field.", hint + fields)


def _list(field_type: FieldType, value: object, path: str) -> Sequence[object]:
    if is_summary(value):
        raise summary_error(path)
    if isinstance(value, np.ndarray):
        return cast("Sequence[object]", value.tolist())
    if isinstance(value, (list, tuple)):
        return cast("Sequence[object]", value)
    hint = "Give bytes as a list of 0 to 255 or as base64." if field_type.base in OCTETS else "Give a list."
    raise BadValue(path, f"{excerpt(value)} given, {field_type} expected.", hint)


def _check_length(field_type: FieldType, length: int, path: str) -> None:
    if field_type.arity == "array" and length != field_type.size:
        raise BadValue(path, f"{length} elements given, {field_type} takes exactly {field_type.size}.")
    if field_type.size and length > field_type.size:
        raise BadValue(path, f"{length} elements given, {field_type} takes at most {field_type.size}.")


def _below(path: str, name: str) -> str:
    return f"{path}.{name}" if path else name
