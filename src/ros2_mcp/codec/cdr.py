"""Bytes ↔ message objects."""

from __future__ import annotations

from struct import error as StructError
from typing import TypeAlias

from rosbags.serde import SerdeError

from ros2_mcp.codec.definitions import Definitions
from ros2_mcp.model.errors import BadData

Message: TypeAlias = object
"""A message as an object with one attribute for each field; numeric arrays are read-only NumPy arrays."""


class Codec:
    """Decodes and encodes messages of the types that its definitions know. May be used from any thread."""

    def __init__(self, definitions: Definitions) -> None:
        self.definitions = definitions

    def decode(self, type_name: str, data: bytes) -> Message:
        """The message in CDR bytes of either byte order, header included.

        Raises:
            BadData: if the bytes do not fit the definition.
            UnknownInterface: if there is no definition.
        """
        store = self.definitions.compiled(type_name)
        try:
            return store.read(type_name, data)
        except (ValueError, StructError, SerdeError) as error:
            raise BadData(
                f"A message of {len(data)} bytes is not a {type_name}: {error}.",
                "Its publisher may have been built with another version of this type.",
            ) from error

    def encode(self, type_name: str, message: Message) -> bytes:
        """The message as little-endian CDR with its header; the same values always give the same bytes.

        `message` comes from `decode` or `check`; anything else is a mistake in the program.
        """
        return self.definitions.compiled(type_name).write(type_name, message)
