"""Paths to fields: `pose.pose.position`, `ranges[0:10]`, `name[-1]`, `transforms[*].header.frame_id`."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from operator import attrgetter
from typing import Any, TypeAlias, cast

import numpy as np

from ros2_mcp.codec.definitions import Definitions
from ros2_mcp.codec.store import attribute
from ros2_mcp.model.errors import BadValue
from ros2_mcp.model.interfaces import OCTETS, TIME, Field, FieldType
from ros2_mcp.model.names import nearest

_PART = re.compile(r"(?P<name>[A-Za-z]\w*)(?P<brackets>(?:\[[^\[\]]*\])?)", re.ASCII)
_INDEX = re.compile(r"-?\d+", re.ASCII)
_SLICE = re.compile(r"(-?\d+)?:(-?\d+)?(?::([1-9]\d*))?", re.ASCII)
_NOT_AN_INDEX = "Write [3], [-1], [0:10], [::5] or [*]."

Pick: TypeAlias = "int | slice | None"


@dataclass(frozen=True, slots=True)
class Step:
    """One field on the way, and what of it is picked: one element, a slice, or (None) the field as it is."""

    field: Field
    pick: Pick = None

    @property
    def type(self) -> FieldType:
        """The type of the field, or of one element where some are picked."""
        return self.field.type if self.pick is None else self.field.type.element


@dataclass(frozen=True, slots=True)
class FieldPath:
    """A path that fits the definition; made with `parse_field`."""

    path: str
    steps: tuple[Step, ...]

    @property
    def type(self) -> FieldType:
        """The type at the end of the path; of one element where several are picked."""
        return self.steps[-1].type

    @property
    def is_list(self) -> bool:
        """Whether it stands for several values."""
        return self.type.arity != "single" or any(isinstance(step.pick, slice) for step in self.steps)

    def value_in(self, message: object) -> Any:
        """The value in a message; beyond a slice, a flat list of all that the path leads to.

        Raises:
            BadValue: where a list has no such element.
        """
        if all(step.pick is None for step in self.steps):
            return value_at(message, self.path)
        return _follow(self.path, self.steps, message)


def parse_field(definitions: Definitions, type_name: str, path: str) -> FieldPath:
    """Reads a path and checks it against the definition.

    Raises:
        BadValue: for a path that does not exist, with the nearest that does.
    """
    steps: list[Step] = []
    inside = FieldType(type_name)
    for part in path.strip().split("."):
        match = _PART.fullmatch(part)
        if match is None:
            raise BadValue(
                path, f"{part!r} is not a field.", f"A path is like pose.position or ranges[0:10]. {_NOT_AN_INDEX}"
            )
        steps.append(_step(definitions, path, inside, match["name"], match["brackets"]))
        inside = steps[-1].type
    return FieldPath(path.strip(), tuple(steps))


def parse_fields(definitions: Definitions, type_name: str, paths: Sequence[str]) -> list[FieldPath]:
    """Several paths, as `parse_field` reads them."""
    return [parse_field(definitions, type_name, path) for path in paths]


def numeric_fields(definitions: Definitions, type_name: str) -> list[str]:
    """The paths of all single numbers, nested ones included: `twist.linear.x`; none inside arrays, no booleans."""
    return list(_numbers(definitions, type_name, only_single=True))


def value_at(message: object, path: str) -> Any:
    """The value at one of the paths that `numeric_fields` gives, or any other made of names and dots."""
    return _getter(path)(message)


@lru_cache(maxsize=4096)
def _getter(path: str) -> attrgetter[Any]:
    return attrgetter(".".join(map(attribute, path.split("."))))


def _step(definitions: Definitions, path: str, inside: FieldType, name: str, brackets: str) -> Step:
    if inside.arity != "single":
        raise BadValue(path, f"{inside} is a list; {name!r} is a field of its elements.", _NOT_AN_INDEX)
    if not inside.is_message:
        raise BadValue(path, f"{inside} has no fields, so {name!r} cannot be one.")
    fields = {field.name: field for field in definitions.structure(inside.base).fields}
    if name not in fields:
        near = nearest(name, list(fields))
        hint = f"Did you mean {near}? " if near else ""
        raise BadValue(path, f"{inside.base} has no field {name!r}.", f"{hint}Its fields are {', '.join(fields)}.")
    field, index = fields[name], brackets[1:-1]
    if not brackets:
        return Step(field)
    if field.type.arity == "single":
        raise BadValue(path, f"{name} is a single {field.type}, not a list.")
    if index == "*":
        return Step(field, slice(None))
    if _INDEX.fullmatch(index):
        return Step(field, int(index))
    match = _SLICE.fullmatch(index)
    if match is None:
        raise BadValue(path, f"[{index}] is not an index.", _NOT_AN_INDEX)
    return Step(field, slice(*(int(bound) if bound else None for bound in match.groups())))


def element_at(values: Any, index: int, path: str) -> Any:
    """One element of a list or array; raises `BadValue` where it is shorter."""
    if not -len(values) <= index < len(values):
        raise BadValue(path, f"there is no element {index}, it has {len(values)}.")
    element = values[index]
    return cast("Any", element).item() if isinstance(element, np.generic) else element


def _follow(path: str, steps: Sequence[Step], value: Any) -> Any:
    for index, step in enumerate(steps, 1):
        value = getattr(value, attribute(step.field.name))
        if isinstance(step.pick, int):
            value = element_at(value, step.pick, path)
        elif step.pick is not None:
            value = value[step.pick]
            if index < len(steps):
                return [leaf for element in value for leaf in _leaves(_follow(path, steps[index:], element))]
    return value


def _leaves(value: Any) -> Sequence[Any]:
    return cast("Sequence[Any]", value) if hasattr(value, "__len__") and not isinstance(value, str) else [value]


# ── what can be measured ─────────────────────────────────────────────────────────────────────────────────────────


def measurable(definitions: Definitions, type_name: str, chosen: Sequence[str] = ()) -> list[FieldPath]:
    """The chosen fields, or all: single numbers, and arrays of numbers as one each; without stamps and bytes.

    A chosen message stands for all its fields; booleans count as 0 and 1 where they are chosen.

    Raises:
        BadValue: for a chosen path that does not exist or has no number in it.
    """
    if not chosen:
        return parse_fields(definitions, type_name, list(_numbers(definitions, type_name)))
    found = [parse_field(definitions, type_name, path) for path in chosen]
    return [path for field_path in found for path in _measurable_at(definitions, type_name, field_path)]


def _measurable_at(definitions: Definitions, type_name: str, chosen: FieldPath) -> list[FieldPath]:
    if chosen.type.is_number or chosen.type.base == "bool":
        return [chosen]
    below = _numbers(definitions, chosen.type.base) if chosen.type.is_message else ()
    start = chosen.path + "[*]" * (chosen.type.arity != "single")
    if paths := [f"{start}.{name}" for name in below]:
        return parse_fields(definitions, type_name, paths)
    raise BadValue(chosen.path, f"it is {chosen.type}, which has no numbers to measure.")


def _numbers(definitions: Definitions, type_name: str, *, only_single: bool = False) -> Iterator[str]:
    """The paths of single numbers, stamps included; or of numbers and arrays of them, without stamps and bytes."""
    for field in definitions.structure(type_name).fields:
        is_single = field.type.arity == "single"
        if field.type.is_number and (is_single or not (only_single or field.type.base in OCTETS)):
            yield field.name
        elif field.type.is_message and is_single and (only_single or field.type.base != TIME):
            below = _numbers(definitions, field.type.base, only_single=only_single)
            yield from (f"{field.name}.{name}" for name in below)
