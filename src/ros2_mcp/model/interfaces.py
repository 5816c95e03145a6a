"""Definitions of messages, services and actions as data."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from ros2_mcp_common.language.field_types import FLOATS, INTEGERS, OCTETS, TEXTS, Arity, FieldType

__all__ = [
    "FLOATS", "HEADER", "INTEGERS", "OCTETS", "PRIMITIVES", "TEXTS", "TIME", "Arity", "Constant", "DefinitionText",
    "Field", "FieldType", "Interface", "Literals", "Structure",
]  # fmt: skip

PRIMITIVES = frozenset({"bool", *INTEGERS, *FLOATS, *TEXTS})

HEADER = "std_msgs/msg/Header"
TIME = "builtin_interfaces/msg/Time"

Literals: TypeAlias = "bool | int | float | str | Sequence[bool | int | float | str]"


@dataclass(frozen=True, slots=True)
class DefinitionText:
    """A definition as written in its file; `format` is `msg`, `srv`, `action` or `idl`."""

    format: str
    text: str


@dataclass(frozen=True, slots=True)
class Field:
    """A field: its type, its default (None if there is none) and the comment beside it."""

    name: str
    type: FieldType
    default: Literals | None = None
    comment: str = ""


@dataclass(frozen=True, slots=True)
class Constant:
    """A constant of a message, with its type, value and comment."""

    name: str
    type: str
    value: bool | int | float | str
    comment: str = ""


@dataclass(frozen=True, slots=True)
class Structure:
    """The fields and constants of one message, or of one side of a service or an action, in order."""

    type: str
    fields: tuple[Field, ...]
    constants: tuple[Constant, ...] = ()
    comment: str = ""


@dataclass(frozen=True, slots=True)
class Interface:
    """A message, service or action (`kind` is `msg`, `srv` or `action`) with all nested types, for display.

    `sides` are in order: `message`; or `request` and `response`; or `goal`, `result` and `feedback`.
    """

    type: str
    kind: str
    sides: Mapping[str, Structure]
    nested: Mapping[str, Structure]

    def text(self) -> str:
        """Return the definition as a listing: each side, then each nested message once."""
        lines: list[str] = []
        for side, structure in self.sides.items():
            lines += [self.type if side == "message" else f"{self.type} {side}", *_lines_of(structure)]
        for name, structure in self.nested.items():
            lines += [name, *_lines_of(structure)]
        return "\n".join(lines)


def _lines_of(structure: Structure) -> Iterator[str]:
    for constant in structure.constants:
        yield _line(f"{constant.type} {constant.name} = {_literal(constant.value)}", constant.comment)
    for field in structure.fields:
        default = "" if field.default is None else f" {_literal(field.default)}"
        yield _line(f"{field.type} {field.name}{default}", field.comment)
    if not structure.constants and not structure.fields:
        yield "  (no fields)"


def _line(text: str, comment: str) -> str:
    return f"  {text}  # {comment}" if comment else f"  {text}"


def _literal(value: Literals) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (str, int, float)):
        return repr(value)
    return f"[{', '.join(_literal(item) for item in value)}]"
