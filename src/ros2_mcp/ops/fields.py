"""Which fields of a message can be measured, and their values."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, cast

from ros2_mcp.codec.definitions import Definitions
from ros2_mcp.codec.select import Selection, element_at, parse_fields, value_at
from ros2_mcp.codec.store import attribute
from ros2_mcp.model.errors import BadValue
from ros2_mcp.model.interfaces import OCTETS, FieldType

_TIME = "builtin_interfaces/msg/Time"


@dataclass(frozen=True, slots=True)
class Reading:
    """A path with the type at its end and a way to read it; `is_list` where it stands for several values."""

    path: str
    type: FieldType
    is_list: bool
    _selection: Selection

    def of(self, message: object) -> Any:
        """The value in a message; raises `BadValue` where a list has no such element."""
        if any(step.pick is not None for step in self._selection.steps):
            return _follow(self._selection, 0, message)
        return value_at(message, self.path)


def reading(definitions: Definitions, type_name: str, path: str) -> Reading:
    """The reading of any path.

    Raises:
        BadValue: for a path that does not exist, with the nearest that does.
    """
    (selection,) = parse_fields(definitions, type_name, [path])
    last = selection.steps[-1]
    field_type = last.field.type if last.pick is None else last.field.type.element
    is_list = field_type.arity != "single" or any(isinstance(step.pick, slice) for step in selection.steps)
    return Reading(selection.path, field_type, is_list, selection)


def measurable(definitions: Definitions, type_name: str, chosen: Sequence[str] = ()) -> list[Reading]:
    """The chosen fields, or all: single numbers, and arrays of numbers as one each; without stamps and bytes.

    A chosen message stands for all its fields; booleans count as 0 and 1 where they are chosen.

    Raises:
        BadValue: for a chosen path that does not exist or has no number in it.
    """
    paths = [below for path in chosen for below in _chosen(definitions, type_name, path)]
    return [reading(definitions, type_name, path) for path in (paths if chosen else _numbers(definitions, type_name))]


def _chosen(definitions: Definitions, type_name: str, path: str) -> list[str]:
    found = reading(definitions, type_name, path)
    if found.type.is_number or found.type.base == "bool":
        return [found.path]
    below = _numbers(definitions, found.type.base) if found.type.is_message else iter(())
    paths = [f"{found.path}{'[*]' * (found.type.arity != 'single')}.{each}" for each in below]
    if not paths:
        raise BadValue(path, f"it is {found.type}, which has no numbers to measure.")
    return paths


def _numbers(definitions: Definitions, type_name: str) -> Iterator[str]:
    for field in definitions.structure(type_name).fields:
        field_type = field.type
        if field_type.is_number and (field_type.arity == "single" or field_type.base not in OCTETS):
            yield field.name
        elif field_type.is_message and field_type.arity == "single" and field_type.base != _TIME:
            yield from (f"{field.name}.{below}" for below in _numbers(definitions, field_type.base))


def _follow(selection: Selection, start: int, value: Any) -> Any:
    for index, step in enumerate(selection.steps[start:], start + 1):
        value = getattr(value, attribute(step.field.name))
        if isinstance(step.pick, int):
            value = element_at(value, step.pick, selection.path)
        elif step.pick is not None:
            value = value[step.pick]
            if index < len(selection.steps):
                return [leaf for each in value for leaf in _leaves(_follow(selection, index, each))]
    return value


def _leaves(value: Any) -> Sequence[Any]:
    return cast("Sequence[Any]", value) if hasattr(value, "__len__") and not isinstance(value, str) else [value]
