"""The rosbags type system as our codec: message classes, and functions that convert their objects from and to bytes.

rosbags generates Python code for each type. Two things differ here. Strings: rosbags has no wide strings, and rejects a
whole message for one string that is not UTF-8; so both kinds of string are registered as types of their own, with the
functions below. And `byte`, unsigned in ROS 2 and signed in rosbags, is stored as `uint8`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from struct import Struct
from typing import Any

from rosbags.interfaces import Msgdef, Nodetype
from rosbags.serde import cdr
from rosbags.typesys.base import normalize_fieldname as attribute
from rosbags.typesys.store import Typestore

from ros2_mcp.model.interfaces import OCTETS, TEXTS, FieldType, Structure

__all__ = ["MessageStore", "attribute", "type_hash"]

_HEADER_SIZE = 4  # of every CDR message: byte order, and options that ROS leaves zero
_LENGTHS = {"le": Struct("<I"), "be": Struct(">I")}
_WIDE = {"le": "utf-32-le", "be": "utf-32-be"}


class Misfit(ValueError):
    """Raised for bytes that are not a message of their type; says why."""


class MessageStore(Typestore):
    """Compiled types; one store for each consistent set of definitions."""

    def __init__(self) -> None:
        super().__init__()
        self.cache.update({"string": _string_type(), "wstring": _wide_string_type()})

    def add(self, structures: Iterable[Structure]) -> None:
        """Make the message classes; types to which the structures refer must be among them or known."""
        self.register({s.type: ([], [(f.name, _node(f.type)) for f in s.fields]) for s in structures})

    def get_msgdef(self, typename: str) -> Msgdef[object]:
        """Compile the CDR functions of a type at its first use (without the ROS 1 functions that rosbags adds)."""
        if typename not in self.cache:
            fields = [(attribute(name), node) for name, node in self.fielddefs[typename][1]]
            getsize, size = cdr.generate_getsize_cdr(fields, self)
            self.cache[typename] = _definition(
                typename,
                fields,
                self.types[typename],
                size,
                getsize,
                cdr.generate_serialize_cdr(fields, self, "le"),
                cdr.generate_deserialize_cdr(fields, self, "le"),
                cdr.generate_deserialize_cdr(fields, self, "be"),
            )
        return self.cache[typename]

    def read(self, type_name: str, data: bytes) -> tuple[object, memoryview]:
        """Decode the message in CDR bytes; return it and the bytes after it.

        Raises:
            ValueError, struct.error, SerdeError: if the bytes do not fit.
        """
        if len(data) < _HEADER_SIZE or data[0] or data[1] > 1:
            raise Misfit(f"it starts with {data[:4].hex(' ') or 'nothing'}, which is not a plain CDR header")
        definition = self.get_msgdef(type_name)
        read = definition.deserialize_cdr_le if data[1] else definition.deserialize_cdr_be
        body = memoryview(data)[_HEADER_SIZE:]
        message, end = read(body, 0, definition.cls, self)
        if end > len(body):
            raise ValueError("it ends too early")
        return message, body[end:]

    def write(self, type_name: str, message: object) -> bytes:
        """Encode as little-endian CDR with its header; padding is zero."""
        return bytes(self.serialize_cdr(message, type_name, little_endian=True))


def type_hash(type_name: str, structures: Mapping[str, Structure]) -> str:
    """Return the RIHS01 hash of a type, with `char` as its equivalent `uint8`. Wide strings are not supported."""
    bare = Typestore()
    for name, structure in structures.items():
        bare.fielddefs[name] = ([], [(f.name, _node(f.type, hashed=True)) for f in structure.fields])
    return bare.hash_rihs01(type_name)


def _node(field_type: FieldType, *, hashed: bool = False) -> Any:
    """Return the node of rosbags' parse tree for a type: as stored, or, with `hashed`, as defined."""
    base = field_type.base
    if field_type.is_message or (base in TEXTS and not hashed):
        element: Any = (Nodetype.NAME, base)
    else:
        is_octet = base == "char" if hashed else base in OCTETS
        element = (Nodetype.BASE, ("uint8" if is_octet else base, field_type.text_bound if hashed else 0))
    if field_type.arity == "single":
        return element
    return (Nodetype.ARRAY if field_type.arity == "array" else Nodetype.SEQUENCE, (element, field_type.size))


def _definition(
    name: str, fields: Any, cls: type, size: int, getsize: Any, write_le: Any, read_le: Any, read_be: Any
) -> Msgdef[object]:
    none: Any = None  # never used: writing big-endian, and ROS 1
    return Msgdef(
        name,
        fields,
        cls,
        size_cdr=size,
        getsize_cdr=getsize,
        serialize_cdr_le=write_le,
        serialize_cdr_be=none,
        deserialize_cdr_le=read_le,
        deserialize_cdr_be=read_be,
        size_ros1=0,
        getsize_ros1=none,
        serialize_ros1=none,
        deserialize_ros1=none,
        getsize_ros1_to_cdr=none,
        ros1_to_cdr=none,
        getsize_cdr_to_ros1=none,
        cdr_to_ros1=none,
    )


def _string_type() -> Msgdef[object]:
    """The codec of `string`: `u32` length with the final zero, then UTF-8 and a zero.

    Bytes that are not UTF-8 become lone surrogates.
    """

    def getsize(pos: int, text: str, _store: object) -> int:
        return pos + 5 + len(text.encode("utf-8", "surrogateescape"))

    def write(raw: memoryview, pos: int, text: str, _store: object) -> int:
        data = text.encode("utf-8", "surrogateescape") + b"\0"
        _LENGTHS["le"].pack_into(raw, pos, len(data))
        raw[pos + 4 : pos + 4 + len(data)] = data
        return pos + 4 + len(data)

    def reader(order: str) -> Callable[..., tuple[str, int]]:
        length_of = _LENGTHS[order].unpack_from

        def read(raw: memoryview, pos: int, _cls: object, _store: object) -> tuple[str, int]:
            end = pos + 4 + length_of(raw, pos)[0]
            if end > len(raw):
                raise Misfit(f"a string of {end - pos - 4} bytes at offset {pos} goes beyond the end")
            data = bytes(raw[pos + 4 : end])
            if data and data[-1]:
                raise Misfit(f"a string at offset {pos} does not end with a zero byte")
            return data[:-1].decode("utf-8", "surrogateescape"), end

        return read

    layout = [("length", _node(FieldType("uint32"))), ("last", _node(FieldType("uint8")))]
    return _definition("string", layout, str, 0, getsize, write, reader("le"), reader("be"))


def _wide_string_type() -> Msgdef[object]:
    """The codec of `wstring`: `u32` number of UTF-16 units, then four bytes per unit.

    This is how Fast DDS and Cyclone DDS write them for ROS 2.
    """

    def getsize(pos: int, text: str, _store: object) -> int:
        return pos + 4 + 2 * len(text.encode("utf-16-le", "surrogatepass"))

    def write(raw: memoryview, pos: int, text: str, _store: object) -> int:
        units = memoryview(text.encode("utf-16-le", "surrogatepass")).cast("H")
        _LENGTHS["le"].pack_into(raw, pos, len(units))
        end = pos + 4 + 4 * len(units)
        raw[pos + 4 : end] = b"".join(_LENGTHS["le"].pack(unit) for unit in units)
        return end

    def reader(order: str) -> Callable[..., tuple[str, int]]:
        length_of = _LENGTHS[order].unpack_from

        def read(raw: memoryview, pos: int, _cls: object, _store: object) -> tuple[str, int]:
            end = pos + 4 + 4 * length_of(raw, pos)[0]
            if end > len(raw):
                raise Misfit(f"a wide string at offset {pos} goes beyond the end")
            wide = bytes(raw[pos + 4 : end]).decode(_WIDE[order], "surrogatepass")
            return wide.encode("utf-16-le", "surrogatepass").decode("utf-16-le", "surrogatepass"), end

        return read

    layout = [("length", _node(FieldType("uint32")))]
    return _definition("wstring", layout, str, 0, getsize, write, reader("le"), reader("be"))
