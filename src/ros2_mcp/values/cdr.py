"""Decode bytes to message objects and encode them: the only module that does."""

from __future__ import annotations

from collections import OrderedDict
from struct import error as StructError
from threading import Lock
from typing import Any, TypeAlias

from rosbags.serde import SerdeError

from ros2_mcp.model.errors import BadData
from ros2_mcp.model.interfaces import FieldType
from ros2_mcp.values.definitions import Definitions
from ros2_mcp.values.store import Misfit, attribute

Message: TypeAlias = object
"""A message as an object with one attribute for each field; numeric arrays are read-only NumPy arrays."""

_PADDING = 3
"""Bytes. DDS pads a message to a multiple of four."""
_REMEMBERED = 24
"""Messages kept decoded: one for each layer of a map, and some more."""


class Codec:
    """Decodes and encodes messages of the types in its definitions. May be used from any thread."""

    def __init__(self, definitions: Definitions) -> None:
        self.definitions = definitions

    def decode(self, type_name: str, data: bytes) -> Message:
        """Decode CDR bytes, of either byte order, with their header.

        Raises:
            BadData: if the bytes do not fit the definition.
            UnknownInterface: if there is no definition.
        """
        store = self.definitions.compiled(type_name)
        try:
            message, rest = store.read(type_name, data)
            if len(rest) > _PADDING and any(rest) and len(rest) > _PADDING + 4 * self._estimates(type_name, message):
                raise _misfit(data, type_name, f"{len(rest)} bytes are left over")
            return message
        except Misfit as error:
            raise _misfit(data, type_name, str(error)) from error
        except (
            ValueError,
            StructError,
            SerdeError,
        ) as error:  # the library's own errors: bytes are missing
            raise _misfit(data, type_name, "it ends before its last field does") from error

    def encode(self, type_name: str, message: Message) -> bytes:
        """Encode a message as little-endian CDR with its header; equal values always give equal bytes.

        `message` must come from `decode` or `check`.
        """
        return self.definitions.compiled(type_name).write(type_name, message)

    def _estimates(self, type_name: str, message: Message) -> int:
        """Return the number of sequences and wide strings in the message.

        rclpy's `serialize_message` only estimates their size, and appends up to four bytes of garbage for each.
        """
        fields = self.definitions.structure(type_name).fields
        return sum(self._estimates_in(field.type, getattr(message, attribute(field.name))) for field in fields)

    def _estimates_in(self, field_type: FieldType, value: Any) -> int:
        own = int(field_type.arity == "sequence")
        elements = [value] if field_type.arity == "single" else value
        if field_type.base == "wstring":
            return own + len(elements)
        if field_type.is_message:
            return own + sum(self._estimates(field_type.base, element) for element in elements)
        return own


class RememberingCodec(Codec):
    """A codec that caches the last decoded messages, for repeated reads of the same bytes.

    Do not modify its messages.
    """

    def __init__(self, definitions: Definitions) -> None:
        super().__init__(definitions)
        self._last: OrderedDict[int, tuple[bytes, Message]] = OrderedDict()
        self._turn = Lock()

    def decode(self, type_name: str, data: bytes) -> Message:
        """Decode as `Codec.decode`, from the cache if possible."""
        with self._turn:
            if id(data) in self._last:  # the bytes are kept, so that no other object gets their address
                self._last.move_to_end(id(data))
                return self._last[id(data)][1]
        message = super().decode(type_name, data)
        with self._turn:
            self._last[id(data)] = data, message
            while len(self._last) > _REMEMBERED:
                self._last.popitem(last=False)
        return message


def _misfit(data: bytes, type_name: str, why: str) -> BadData:
    return BadData(
        f"A message of {len(data)} bytes is not a {type_name}: {why}.",
        "Its publisher may have been built with another version of this type.",
    )
