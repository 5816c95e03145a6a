"""What the definitions of messages, services and actions say."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

INTEGERS: Mapping[str, tuple[int, int]] = {
    "byte": (0, 2**8 - 1),
    "char": (0, 2**8 - 1),
    **{f"uint{bits}": (0, 2**bits - 1) for bits in (8, 16, 32, 64)},
    **{f"int{bits}": (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) for bits in (8, 16, 32, 64)},
}
"""The integer types with the smallest and the largest value; `byte` and `char` are unsigned in ROS 2."""
FLOATS = frozenset({"float32", "float64"})
TEXTS = frozenset({"string", "wstring"})
OCTETS = frozenset({"uint8", "byte", "char"})
PRIMITIVES = frozenset({"bool", *INTEGERS, *FLOATS, *TEXTS})

HEADER = "std_msgs/msg/Header"
TIME = "builtin_interfaces/msg/Time"

Literals: TypeAlias = "bool | int | float | str | Sequence[bool | int | float | str]"
Arity: TypeAlias = Literal["single", "array", "sequence"]


@dataclass(frozen=True, slots=True)
class DefinitionText:
    """A definition as it is written in the file that defines it; `format` is `msg`, `srv`, `action` or `idl`."""

    format: str
    text: str


@dataclass(frozen=True, slots=True)
class FieldType:
    """The type of a field.

    `base` is a primitive such as `float64` or the full name of a message. `size` is the length of an array, or the
    bound of a sequence (0: unbounded); `text_bound` the bound of each string in characters (0: unbounded).
    """

    base: str
    arity: Arity = "single"
    size: int = 0
    text_bound: int = 0

    @property
    def is_message(self) -> bool:
        """Whether it is made of messages."""
        return "/" in self.base

    @property
    def is_number(self) -> bool:
        """Whether it is made of integers or floating-point numbers."""
        return self.base in INTEGERS or self.base in FLOATS

    @property
    def element(self) -> FieldType:
        """The type of one element of an array or sequence."""
        return FieldType(self.base, text_bound=self.text_bound)

    def __str__(self) -> str:
        text = f"{self.base}<={self.text_bound}" if self.text_bound else self.base
        if self.arity == "single":
            return text
        if self.arity == "array":
            return f"{text}[{self.size}]"
        return f"{text}[<={self.size}]" if self.size else f"{text}[]"


@dataclass(frozen=True, slots=True)
class Field:
    """A field: its type, its default (None where the definition gives none) and the comment written beside it."""

    name: str
    type: FieldType
    default: Literals | None = None
    comment: str = ""


@dataclass(frozen=True, slots=True)
class Constant:
    """A constant."""

    name: str
    type: str
    value: bool | int | float | str
    comment: str = ""


@dataclass(frozen=True, slots=True)
class Structure:
    """The fields and constants of one message, or of one side of a service or an action, in their order."""

    type: str
    fields: tuple[Field, ...]
    constants: tuple[Constant, ...] = ()
    comment: str = ""


@dataclass(frozen=True, slots=True)
class Interface:
    """A message, service or action (`kind` is `msg`, `srv` or `action`) with all that it refers to, for showing.

    `sides` in their order: `message`; or `request` and `response`; or `goal`, `result` and `feedback`.
    """

    type: str
    kind: str
    sides: Mapping[str, Structure]
    nested: Mapping[str, Structure]

    def text(self) -> str:
        """The definition as a listing: each side, then each nested message once."""
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
