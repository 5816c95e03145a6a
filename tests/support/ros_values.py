"""Values of any message type for the tests: filled from a seed, as an agent writes them, compared, and as CDR bytes.

Nothing of this uses the code under test. Messages are rclpy's own classes.
"""

from __future__ import annotations

import base64
import math
import random
import string
import struct
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

from rosidl_parser import definition as idl

LETTERS = string.ascii_letters + "äß€漢字\n\t\"'\\"
SPECIAL_FLOATS = (math.nan, math.inf, -math.inf, 0.0, -0.0, 0.1, sys.float_info.max, 5e-324)
FORMATS = {
    "boolean": "?", "octet": "B", "float": "f", "double": "d",
    "int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i", "uint32": "I", "int64": "q", "uint64": "Q",
}  # fmt: skip


def installed_types() -> list[str]:
    """Every message type of the installation, such as `std_msgs/msg/String`."""
    paths = Path(sys.prefix).glob("share/*/msg/*.msg")
    return sorted(f"{path.parts[-3]}/msg/{path.stem}" for path in paths)


def message_class(name: str) -> type:
    package, _, short = name.split("/")
    return getattr(import_module(f"{package}.msg"), short)


def slots(cls: type) -> Iterator[tuple[str, Any]]:
    """Name and type of every field."""
    for slot, kind in zip(cls.__slots__, cls.SLOT_TYPES, strict=False):
        if slot != "_check_fields":
            yield slot.removeprefix("_"), kind


def filled(name: str, seed: int) -> Any:
    """A message whose every value, NaN and the limits of integers among them, follows from the type and the seed."""
    return _filled(message_class(name), random.Random(f"{name} {seed}"))


def _filled(cls: type, dice: random.Random) -> Any:
    message = cls()
    for field, kind in slots(cls):
        if field != "structure_needs_at_least_one_member":
            setattr(message, field, _value(kind, dice))
    return message


def _value(kind: Any, dice: random.Random) -> Any:
    if isinstance(kind, idl.Array):
        return [_value(kind.value_type, dice) for _ in range(kind.size)]
    if isinstance(kind, idl.BoundedSequence):
        return [_value(kind.value_type, dice) for _ in range(dice.choice((0, 1, min(kind.maximum_size, 20))))]
    if isinstance(kind, idl.UnboundedSequence):
        most = 3 if isinstance(kind.value_type, idl.NamespacedType) else 70
        return [_value(kind.value_type, dice) for _ in range(dice.choice((0, 1, most)))]
    if isinstance(kind, idl.NamespacedType):
        return _filled(message_class("/".join([*kind.namespaces, kind.name])), dice)
    if isinstance(kind, idl.AbstractGenericString):
        most = kind.maximum_size // 3 if kind.has_maximum_size() else 12
        return "".join(dice.choices(LETTERS, k=dice.randint(0, most)))
    return _primitive(kind.typename, dice)


def _primitive(name: str, dice: random.Random) -> Any:
    if name == "boolean":
        return dice.random() < 0.5
    if name == "octet":
        return bytes([dice.randrange(256)])
    if name in ("float", "double"):
        value = dice.choice((*SPECIAL_FLOATS, dice.gauss(0, 1e6), dice.random()))
        return _as_float32(value) if name == "float" else value
    bits = 8 * struct.calcsize(FORMATS[name])
    low, high = (0, 2**bits - 1) if name.startswith("u") else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
    return dice.choice((low, high, 0, dice.randint(low, high)))


def _as_float32(value: float) -> float:
    if math.isfinite(value) and abs(value) > 3e38:
        return 3.4028234663852886e38
    return struct.unpack("<f", struct.pack("<f", value))[0]


def as_agent(message: Any) -> dict[str, Any]:
    """The message as an agent writes it: NaN and infinities as text, big integers as text, some bytes as base64."""
    fields = [field for field, _ in slots(type(message)) if field != "structure_needs_at_least_one_member"]
    return {field: _as_agent(getattr(message, field)) for field in fields}


def _as_agent(value: Any) -> Any:
    if hasattr(value, "SLOT_TYPES"):
        return as_agent(value)
    if isinstance(value, bytes):
        return value[0]
    if isinstance(value, float) and not math.isfinite(value):
        return "nan" if math.isnan(value) else "inf" if value > 0 else "-inf"
    if isinstance(value, int) and not isinstance(value, bool):
        return value if abs(value) <= 2**53 else str(value)
    if isinstance(value, (str, bool, float)):
        return value
    values = _plain(value)
    if getattr(value, "typecode", "") == "B" and len(values) > 64:
        return base64.b64encode(bytes(values)).decode()
    return [_as_agent(element) for element in values]


def difference(one: Any, other: Any, path: str = "message") -> str:
    """Where two messages differ first; empty where they are the same to the last bit (one NaN equals another)."""
    one, other = _plain(one), _plain(other)
    if hasattr(one, "SLOT_TYPES"):
        fields = [field for field, _ in slots(type(one))]
        pairs = ((getattr(one, field), getattr(other, field), f"{path}.{field}") for field in fields)
    elif isinstance(one, (str, bytes, bool, int, float)):
        return "" if _same(one, other) else f"{path}: {one!r} and {other!r}"
    elif len(one) != len(other):
        return f"{path}: length {len(one)} and {len(other)}"
    else:
        pairs = ((a, b, f"{path}[{index}]") for index, (a, b) in enumerate(zip(one, other, strict=True)))
    return next((found for a, b, where in pairs if (found := difference(a, b, where))), "")


def _plain(value: Any) -> Any:
    return value.tolist() if hasattr(value, "tolist") else value


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, float):
        return struct.pack("<d", one) == struct.pack("<d", other) or (math.isnan(one) and math.isnan(other))
    return one == other


def with_ramp(name: str, field: str, length: int) -> Any:
    """A message with one long array of numbers that tell their place."""
    message = message_class(name)()
    kind = dict(slots(type(message)))[field].value_type.typename
    modulo = 251 if kind in ("uint8", "octet") else 2**31
    numbers = [index * 7919 % modulo for index in range(length)]
    floating = kind in ("float", "double")
    setattr(message, field, [number / 8 for number in numbers] if floating else numbers)
    return message


class _Cdr:
    """CDR bytes with zeros as padding, beside a mask that is 0 where there is padding."""

    def __init__(self) -> None:
        self.data, self.mask = bytearray(), bytearray()

    def put(self, packed: bytes, alignment: int) -> None:
        padding = -len(self.data) % alignment
        self.data += bytes(padding) + packed
        self.mask += bytes(padding) + b"\xff" * len(packed)

    def value(self, kind: Any, value: Any) -> None:
        if isinstance(kind, idl.AbstractNestedType):
            if not isinstance(kind, idl.Array):
                self.put(struct.pack("<I", len(value)), 4)
            for element in _plain(value):
                self.value(kind.value_type, element)
        elif isinstance(kind, idl.NamespacedType):
            self.message(value)
        elif isinstance(kind, idl.AbstractGenericString):
            self.text(value, wide=isinstance(kind, idl.AbstractWString))
        else:
            packed = value if isinstance(value, bytes) else struct.pack("<" + FORMATS[kind.typename], value)
            self.put(packed, len(packed))

    def message(self, message: Any) -> None:
        """Its fields one after the other; one without fields is a single byte that means nothing."""
        fields = list(slots(type(message)))
        for field, kind in fields:
            self.value(kind, getattr(message, field))
        if not fields:
            self.data, self.mask = self.data + b"\0", self.mask + b"\0"

    def text(self, text: str, *, wide: bool) -> None:
        """A text with its end, or one UTF-16 unit in every four bytes without any."""
        units = text.encode("utf-16-le")
        data = (
            b"".join(units[at : at + 2] + b"\0\0" for at in range(0, len(units), 2)) if wide else text.encode() + b"\0"
        )
        self.put(struct.pack("<I", len(data) // 4 if wide else len(data)), 4)
        self.put(data, 1)


def cdr_difference(message: Any, data: bytes) -> str:
    """How CDR bytes differ from those of the message, padding aside; empty where they do not."""
    cdr = _Cdr()
    cdr.message(message)
    body = data[4:]
    if data[:4] != b"\0\1\0\0" or not 0 <= len(body) - len(cdr.data) <= 3:
        return f"head {data[:4].hex()}, {len(body)} bytes for {len(cdr.data)}"
    pairs = enumerate(zip(cdr.data, body, cdr.mask, strict=False))
    return next((f"byte {at}: {one} and {other}" for at, (one, other, mask) in pairs if (one ^ other) & mask), "")
