"""JSON messages of recordings as the objects that messages are here: with fields, whose types their values tell.

JSON has no types of its own. So a *shape* is made of many messages of a topic, and of its JSON schema where there is
one: which fields there are, and what each of them is in all messages.
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
"""The one field of a message that is no object."""
_INT64 = 1 << 63
_DTYPES = {"bool": np.bool_, "int64": np.int64, "float64": np.float64}
_SCHEMA_KINDS = {"boolean": "bool", "integer": "int64", "number": "float64", "string": "string"}
_DEEPEST = 40
"""Levels of a schema that are followed; one may refer to itself."""


@dataclass
class Shape:
    """What a value is in all messages: of a `kind` (`null` until a value came, `any` where they differ).

    The kinds are `bool`, `int64`, `float64`, `string`, `list` (of `element`), `object` (with `fields`), `null`, `any`.
    """

    kind: str = "null"
    fields: dict[str, Shape] = field(default_factory=dict[str, "Shape"])
    element: Shape | None = None

    def add(self, value: Any) -> None:
        """Takes in a value."""
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
        """Takes in what a JSON schema says; what it leaves open is left open."""
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
        """The type of a field of this shape, whose `base` is empty where it is a message."""
        if self.kind == "list":
            element = self.element or Shape()
            if element.kind in ("list", "null", "any"):
                return FieldType("string", "sequence")
            return FieldType("" if element.kind == "object" else element.kind, "sequence")
        if self.kind == "object":
            return FieldType("")
        return FieldType(self.kind if self.kind in (*_DTYPES, "string") else "string")


class JsonMessage:
    """A message, or one of its parts; a field that it does not have has no attribute."""


_Part: TypeAlias = "tuple[str, str, FieldType, _Plan | None]"
"""A field: its name, its attribute, its type, and how its own fields are read where it is a message."""


@dataclass
class _Plan:
    """How the objects of one shape are read."""

    structure: Structure
    parts: list[_Part] = field(default_factory=list[_Part])

    def made(self, value: Mapping[str, Any]) -> JsonMessage:
        """The object; raises `ValueError` for a value of another kind than its field."""
        message = JsonMessage()
        for name, as_attribute, kind, below in self.parts:
            if name in value:
                setattr(message, as_attribute, _value(name, kind, below, value[name]))
        return message


class RecordedCodec(Codec):
    """Decodes the messages of a recording: CDR, and JSON of the types whose shape it has been given."""

    def __init__(self, definitions: Definitions) -> None:
        super().__init__(definitions)
        self._plans: dict[str, _Plan] = {}

    def learn_json(self, type_name: str, shape: Shape) -> None:
        """Takes in what messages of a JSON type are like; it replaces what was known of the type."""
        if shape.kind != "object":
            shape = Shape("object", {_VALUE: shape})
        plans: list[_Plan] = []
        plan = _planned(type_name, shape, plans)
        self.definitions.add_plain([each.structure for each in plans])
        self._plans[type_name] = plan

    def knows_json(self, type_name: str) -> bool:
        """Whether it has been given the shape of such messages."""
        return type_name in self._plans

    def decode(self, type_name: str, data: bytes) -> Message:
        """The message in its bytes; raises as `Codec.decode`."""
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
    """A JSON value; raises `BadData` for bytes that are none."""
    try:
        return json.loads(data)
    except (ValueError, RecursionError) as error:  # also for bytes that are no text
        place = f" from character {error.pos + 1} on" if isinstance(error, json.JSONDecodeError) else ""
        raise BadData(f"A message of {len(data)} bytes is not JSON{place}.") from error


def shape_of(schema: str, messages: Iterable[bytes]) -> Shape:
    """The shape of a topic's messages; what is not JSON is left out."""
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
    """Whether a JSON schema says which fields there are."""
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
    """The plan of an object; it and those of what it contains are appended."""
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
    """A value as messages have it; None for null. Raises `ValueError` where it is of another kind."""
    if value is None:
        return None
    if kind.arity == "single":
        return _single(name, kind, below, value)
    if not isinstance(value, list):
        raise ValueError(f"{quoted(name)} is no list")
    elements = cast("list[Any]", value)
    if kind.base in _DTYPES:
        numbers = [np.nan if each is None else _single(name, kind, below, each) for each in elements]
        dtype = np.float64 if None in elements else _DTYPES[kind.base]
        return np.array(numbers, dtype)
    return [_single(name, kind, below, {} if each is None and below else each) for each in elements]


def _single(name: str, kind: FieldType, below: _Plan | None, value: Any) -> Any:
    if below is not None:
        if not isinstance(value, dict):
            raise ValueError(f"{quoted(name)} is no object")
        return below.made(cast("Mapping[str, Any]", value))
    if kind.base == "string":  # what differs from message to message, or has no type here, is shown as it is written
        return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False, separators=(",", ":"))
    if kind.base == "float64" and isinstance(value, (int, float)) and not isinstance(value, bool):
        return float(value)
    if _kind_of(value) != kind.base:
        raise ValueError(f"{quoted(name)} is no {kind.base}")
    return value
