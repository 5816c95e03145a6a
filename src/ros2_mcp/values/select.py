"""Paths to fields: `pose.pose.position`, `ranges[0:10]`, `name[-1]`, `transforms[*].header.frame_id`.

`transforms[child_frame_id == "base_link"]` selects the elements for which the comparison is true.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ros2_mcp.model.errors import BadValue
from ros2_mcp.model.interfaces import OCTETS, TIME, Field
from ros2_mcp.values.definitions import Definitions
from ros2_mcp_common.language import paths
from ros2_mcp_common.language.field_types import Single, Types
from ros2_mcp_common.language.paths import PathError, Step, several_of, value_at

__all__ = [
    "FieldPath", "Step", "element_at", "known_to", "measurable", "numeric_fields", "parse_field", "parse_fields",
    "several_of", "value_at",
]  # fmt: skip


@dataclass(frozen=True)
class FieldPath(paths.FieldPath):
    """A path that is valid for its type; made with `parse_field`."""

    def value_in(self, message: object) -> Any:
        """Return the value in a message; beyond a slice, a flat list of all values to which the path leads.

        Raises:
            BadValue: if a list has no such element.
        """
        try:
            return super().value_in(message)
        except PathError as error:
            raise _bad(error) from error


class _Known:
    """Fields and constants of types, from definitions."""

    def __init__(self, definitions: Definitions) -> None:
        self._definitions = definitions

    def fields(self, type_name: str) -> Mapping[str, Field]:
        return {field.name: field for field in self._definitions.structure(type_name).fields}

    def constants(self, type_name: str) -> Mapping[str, Single]:
        return {constant.name: constant.value for constant in self._definitions.structure(type_name).constants}


def known_to(definitions: Definitions) -> Types:
    """Return the types of these definitions for code shared with the bridge; raises `UnknownInterface` for others."""
    return _Known(definitions)


def _bad(error: PathError) -> BadValue:
    return BadValue(error.path, error.message, error.hint)


def parse_field(definitions: Definitions, type_name: str, path: str) -> FieldPath:
    """Parse a path and check it against the definition.

    Raises:
        BadValue: for a path that does not exist; names the nearest one that does.
    """
    try:
        found = paths.parse(known_to(definitions), type_name, path)
    except PathError as error:
        raise _bad(error) from error
    return FieldPath(found.path, found.steps)


def element_at(values: Any, index: int, path: str) -> Any:
    """Return one element of a list or array; raises `BadValue` if the index is out of range."""
    try:
        return paths.element_at(values, index, path)
    except PathError as error:
        raise _bad(error) from error


def parse_fields(definitions: Definitions, type_name: str, paths: Sequence[str]) -> list[FieldPath]:
    """Parse several paths with `parse_field`."""
    return [parse_field(definitions, type_name, path) for path in paths]


def numeric_fields(definitions: Definitions, type_name: str) -> list[str]:
    """Return the paths of all single numbers, also in nested messages: `twist.linear.x`.

    Numbers in arrays, and booleans, are excluded.
    """
    return list(_numbers(definitions, type_name, only_single=True))


# ── what can be measured ─────────────────────────────────────────────────────────────────────────────────────────


def measurable(definitions: Definitions, type_name: str, chosen: Sequence[str] = ()) -> list[FieldPath]:
    """Return the chosen numeric fields, or all: single numbers, and arrays as one each, but no stamps or bytes.

    A chosen message is replaced by all its numeric fields; chosen booleans count as 0 and 1.

    Raises:
        BadValue: for a chosen path that does not exist or contains no number.
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
    """Yield the paths of single numbers, with stamps; or of numbers and arrays of numbers, without stamps and bytes."""
    for field in definitions.structure(type_name).fields:
        is_single = field.type.arity == "single"
        if field.type.is_number and (is_single or not (only_single or field.type.base in OCTETS)):
            yield field.name
        elif field.type.is_message and is_single and (only_single or field.type.base != TIME):
            below = _numbers(definitions, field.type.base, only_single=only_single)
            yield from (f"{field.name}.{name}" for name in below)
