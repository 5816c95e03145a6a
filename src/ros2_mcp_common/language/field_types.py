"""The types of fields, as message definitions write them. Server and bridge share them. Needs no ROS."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, Protocol

INTEGERS: Mapping[str, tuple[int, int]] = {
    "byte": (0, 2**8 - 1),
    "char": (0, 2**8 - 1),
    **{f"uint{bits}": (0, 2**bits - 1) for bits in (8, 16, 32, 64)},
    **{f"int{bits}": (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) for bits in (8, 16, 32, 64)},
}
"""The integer types, each with its least and largest value; `byte` and `char` are unsigned in ROS 2."""
FLOATS = frozenset({"float32", "float64"})
TEXTS = frozenset({"string", "wstring"})
OCTETS = frozenset({"uint8", "byte", "char"})

Arity = Literal["single", "array", "sequence"]
Single = bool | int | float | str
"""The value of a constant."""


@dataclass(frozen=True)
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
        """Whether the values are messages."""
        return "/" in self.base or ":" in self.base  # such as `json:app.State` in a recording

    @property
    def is_number(self) -> bool:
        """Whether the values are integers or floating-point numbers."""
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


class TypedField(Protocol):
    """A field of a message: at least its name and type."""

    @property
    def name(self) -> str:
        """The name in the definition."""
        ...

    @property
    def type(self) -> FieldType:
        """The type of the field."""
        ...


class Types(Protocol):
    """The known message types: the server reads definitions, the bridge reads the classes of rclpy."""

    def fields(self, type_name: str) -> Mapping[str, TypedField]:
        """Return the fields of a message by name, in their order."""
        ...

    def constants(self, type_name: str) -> Mapping[str, Single]:
        """Return the constants of a message; a `byte` is an integer."""
        ...
