"""Paths to fields: `pose.pose.position`, `ranges[0:10]`, `name[-1]`, `transforms[*].header.frame_id`."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from operator import attrgetter
from typing import Any, TypeAlias, cast

import numpy as np

from ros2_mcp.codec.definitions import Definitions
from ros2_mcp.codec.store import attribute
from ros2_mcp.model.errors import BadValue
from ros2_mcp.model.interfaces import Field, FieldType
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


@dataclass(frozen=True, slots=True)
class Selection:
    """A path that fits the definition."""

    path: str
    steps: tuple[Step, ...]


def parse_fields(definitions: Definitions, type_name: str, paths: Sequence[str]) -> list[Selection]:
    """Reads paths and checks them against the definition.

    Raises:
        BadValue: for a path that does not exist, with the nearest that does.
    """
    return [_parse(definitions, type_name, path) for path in paths]


def numeric_fields(definitions: Definitions, type_name: str) -> list[str]:
    """The paths of all single numbers, nested ones included: `twist.linear.x`; none inside arrays, no booleans."""
    paths: list[str] = []
    for field in definitions.structure(type_name).fields:
        if field.type.arity != "single":
            continue
        if field.type.is_message:
            paths += [f"{field.name}.{below}" for below in numeric_fields(definitions, field.type.base)]
        elif field.type.is_number:
            paths.append(field.name)
    return paths


def value_at(message: object, path: str) -> Any:
    """The value at one of the paths that `numeric_fields` gives, or any other made of names and dots."""
    return _getter(path)(message)


@lru_cache(maxsize=4096)
def _getter(path: str) -> attrgetter[Any]:
    return attrgetter(".".join(map(attribute, path.split("."))))


def _parse(definitions: Definitions, type_name: str, path: str) -> Selection:
    steps: list[Step] = []
    inside = FieldType(type_name)
    for part in path.strip().split("."):
        match = _PART.fullmatch(part)
        if match is None:
            raise BadValue(
                path, f"{part!r} is not a field.", f"A path is like pose.position or ranges[0:10]. {_NOT_AN_INDEX}"
            )
        step = _step(definitions, path, inside, match["name"], match["brackets"][1:-1] if match["brackets"] else None)
        steps.append(step)
        inside = step.field.type if step.pick is None else step.field.type.element
    return Selection(path.strip(), tuple(steps))


def _step(definitions: Definitions, path: str, inside: FieldType, name: str, index: str | None) -> Step:
    if inside.arity != "single":
        raise BadValue(path, f"{inside} is a list; {name!r} is a field of its elements.", _NOT_AN_INDEX)
    if not inside.is_message:
        raise BadValue(path, f"{inside} has no fields, so {name!r} cannot be one.")
    field = _field(definitions, path, inside.base, name)
    if index is None:
        return Step(field)
    if field.type.arity == "single":
        raise BadValue(path, f"{name} is a single {field.type}, not a list.")
    return Step(field, _pick(path, index))


def _field(definitions: Definitions, path: str, type_name: str, name: str) -> Field:
    fields = {field.name: field for field in definitions.structure(type_name).fields}
    if name in fields:
        return fields[name]
    near = nearest(name, list(fields))
    hint = f"Did you mean {near}? " if near else ""
    raise BadValue(path, f"{type_name} has no field {name!r}.", f"{hint}Its fields are {', '.join(fields)}.")


def _pick(path: str, text: str) -> int | slice:
    if text == "*":
        return slice(None)
    if _INDEX.fullmatch(text):
        return int(text)
    match = _SLICE.fullmatch(text)
    if match is None:
        raise BadValue(path, f"[{text}] is not an index.", _NOT_AN_INDEX)
    return slice(*(int(bound) if bound else None for bound in match.groups()))


def element_at(values: Any, index: int, path: str) -> Any:
    """One element of a list or array; raises `BadValue` where it is shorter."""
    if not -len(values) <= index < len(values):
        raise BadValue(path, f"there is no element {index}, it has {len(values)}.")
    element = values[index]
    return cast("Any", element).item() if isinstance(element, np.generic) else element
