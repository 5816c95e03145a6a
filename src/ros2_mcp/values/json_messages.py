"""Decode JSON messages of recordings to message objects; the types of their fields are inferred from the values.

JSON messages have no declared types. So a *shape* is inferred from many messages of a topic, and from its JSON schema
if there is one: the fields, and the type of each over all messages.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias, cast

import numpy as np

from ros2_mcp.model.errors import BadData
from ros2_mcp.model.interfaces import Field, FieldType, Structure
from ros2_mcp.model.text import quoted
from ros2_mcp.values.cdr import Codec, Message
from ros2_mcp.values.definitions import Definitions
from ros2_mcp.values.store import attribute

_VALUE = "value"
"""The field that contains a message that is not a JSON object."""
_INT64 = 1 << 63
_DTYPES = {"bool": np.bool_, "int64": np.int64, "float64": np.float64}
_SCHEMA_KINDS = {"boolean": "bool", "integer": "int64", "number": "float64", "string": "string"}
_DEEPEST = 40
"""Levels of a schema that are followed; a schema may refer to itself."""


@dataclass
class Shape:
    """The type of a value over all messages: `kind` is `null` until there is a value, and `any` if the types differ.

    The kinds are `bool`, `int64`, `float64`, `string`, `list` (of `element`), `object` (with `fields`), `null`, `any`.
    """

    kind: str = "null"
    fields: dict[str, Shape] = field(default_factory=dict[str, "Shape"])
    element: Shape | None = None

    def add(self, value: Any) -> None:
        """Widen the shape by a value."""
        if value is None:
            return
        kind = _kind_of(value)
        self._widen(kind)
        if self.kind == "object" and kind == "object":
            for name, below in cast("Mapping[str, Any]", value).items():
                self.fields.setdefault(name, Shape()).add(below)
        elif self.kind == "list" and kind == "list":
            self.element = self.element or Shape()
            for below in cast("Sequence[Any]", value):
                self.element.add(below)

    def add_schema(self, schema: Any, depth: int = 0) -> None:
        """Widen the shape by a JSON schema; what the schema does not declare stays open."""
        if not isinstance(schema, Mapping) or depth > _DEEPEST:
            return
        told = cast("Mapping[str, Any]", schema)
        kind = told.get("type")
        properties, items = told.get("properties"), told.get("items")
        if isinstance(properties, Mapping) and kind in ("object", None):
            self._widen("object")
            for name, below in cast("Mapping[str, Any]", properties).items():
                self.fields.setdefault(name, Shape()).add_schema(below, depth + 1)
        elif kind == "array":
            self._widen("list")
            self.element = self.element or Shape()
            self.element.add_schema(items, depth + 1)
        elif isinstance(kind, str) and kind in _SCHEMA_KINDS:
            self._widen(_SCHEMA_KINDS[kind])

    def _widen(self, kind: str) -> None:
        if self.kind == "null":
            self.kind = kind
        elif self.kind != kind:
            self.kind = "float64" if {self.kind, kind} == {"int64", "float64"} else "any"

    @property
    def field_type(self) -> FieldType:
        """The type of a field of this shape; `base` is empty for a message."""
        if self.kind == "list":
            element = self.element or Shape()
            if element.kind in ("list", "null", "any"):
                return FieldType("string", "sequence")
            return FieldType("" if element.kind == "object" else element.kind, "sequence")
        if self.kind == "object":
            return FieldType("")
        return FieldType(self.kind if self.kind in (*_DTYPES, "string") else "string")


class JsonMessage:
    """A message or a nested message; a field that is absent in the JSON has no attribute."""


_Part: TypeAlias = "tuple[str, str, FieldType, _Plan | None]"
"""A field: its name, attribute and type, and for a message the plan of its own fields."""


@dataclass
class _Plan:
    """The conversion of JSON objects of one shape."""

    structure: Structure
    parts: list[_Part] = field(default_factory=list[_Part])

    def made(self, value: Mapping[str, Any]) -> JsonMessage:
        """Convert a JSON object; raises `ValueError` if a value does not have its field's type."""
        message = JsonMessage()
        for name, as_attribute, kind, below in self.parts:
            if name in value:
                setattr(message, as_attribute, _value(name, kind, below, value[name]))
        return message


class RecordedCodec(Codec):
    """Decodes the messages of a recording: CDR, and JSON of types whose shape is known."""

    def __init__(self, definitions: Definitions) -> None:
        super().__init__(definitions)
        self._plans: dict[str, _Plan] = {}

    def learn_json(self, type_name: str, shape: Shape) -> None:
        """Set the shape of a JSON type; it replaces an earlier shape."""
        if shape.kind != "object":
            shape = Shape("object", {_VALUE: shape})
        plans: list[_Plan] = []
        plan = _planned(type_name, shape, plans)
        self.definitions.add_plain([each.structure for each in plans])
        self._plans[type_name] = plan

    def knows_json(self, type_name: str) -> bool:
        """Return whether the shape of this JSON type is known."""
        return type_name in self._plans

    def decode(self, type_name: str, data: bytes) -> Message:
        """Decode a message; raises the errors of `Codec.decode`."""
        plan = self._plans.get(type_name)
        if plan is None:
            return super().decode(type_name, data)
        value = parsed(data)
        whole = cast("Mapping[str, Any]", value) if isinstance(value, dict) else {_VALUE: value}
        try:
            return plan.made(whole)
        except ValueError as error:
            raise BadData(f"A JSON message of {len(data)} bytes is unlike the others of its topic: {error}.") from error


def parsed(data: bytes) -> Any:
    """Parse JSON; raises `BadData` for invalid JSON."""
    try:
        return json.loads(data)
    except (ValueError, RecursionError) as error:  # also for bytes that are not UTF-8
        place = f" from character {error.pos + 1} on" if isinstance(error, json.JSONDecodeError) else ""
        raise BadData(f"A message of {len(data)} bytes is not JSON{place}.") from error


def shape_of(schema: str, messages: Iterable[bytes]) -> Shape:
    """Return the shape of a topic's messages; messages that are not JSON are skipped."""
    shape = Shape()
    for data in messages:
        try:
            shape.add(parsed(data))
        except BadData:
            continue
    try:
        told = json.loads(schema) if schema else None
    except (ValueError, RecursionError):
        told = None
    if shape.kind in ("object", "null"):
        shape.add_schema(told)
    return shape


def is_usable_schema(schema: str) -> bool:
    """Return whether a JSON schema declares any fields or a type."""
    shape = shape_of(schema, ())
    return shape.kind != "null" and not (shape.kind == "object" and not shape.fields)


def _kind_of(value: Any) -> str:
    if isinstance(value, bool):
        return "bool"
    if isinstance(value, int):
        return "int64" if -_INT64 <= value < _INT64 else "float64"
    if isinstance(value, float):
        return "float64"
    return "string" if isinstance(value, str) else "list" if isinstance(value, list) else "object"


def _planned(title: str, shape: Shape, plans: list[_Plan]) -> _Plan:
    """Return the plan of an object; append it and the plans of its nested objects to `plans`."""
    parts = list(_parts_of(title, shape, plans))
    plan = _Plan(Structure(title, tuple(Field(name, kind) for name, _, kind, _ in parts)), parts)
    plans.append(plan)
    return plan


def _parts_of(title: str, shape: Shape, plans: list[_Plan]) -> Iterator[_Part]:
    for name, below in shape.fields.items():
        kind = below.field_type
        inner = below.element if below.kind == "list" else below
        if kind.base or inner is None:
            yield name, attribute(name), kind, None
        else:
            plan = _planned(f"{title}.{name}", inner, plans)
            yield name, attribute(name), FieldType(plan.structure.type, kind.arity), plan


def _value(name: str, kind: FieldType, below: _Plan | None, value: Any) -> Any:
    """Convert a value to its field's type; None for null. Raises `ValueError` if it has another type."""
    if value is None:
        return None
    if kind.arity == "single":
        return _single(name, kind, below, value)
    if not isinstance(value, list):
        raise ValueError(f"{quoted(name)} is not a list")
    elements = cast("list[Any]", value)
    if kind.base in _DTYPES:
        numbers = [np.nan if each is None else _single(name, kind, below, each) for each in elements]
        dtype = np.float64 if None in elements else _DTYPES[kind.base]
        return np.array(numbers, dtype)
    return [_single(name, kind, below, {} if each is None and below else each) for each in elements]


def _single(name: str, kind: FieldType, below: _Plan | None, value: Any) -> Any:
    if below is not None:
        if not isinstance(value, dict):
            raise ValueError(f"{quoted(name)} is not an object")
        return below.made(cast("Mapping[str, Any]", value))
    if kind.base == "string":  # a value whose type differs between messages, or is not known here, becomes JSON text
        return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False, separators=(",", ":"))
    if kind.base == "float64" and isinstance(value, (int, float)) and not isinstance(value, bool):
        return float(value)
    if _kind_of(value) != kind.base:
        raise ValueError(f"{quoted(name)} is no {kind.base}")
    return value
