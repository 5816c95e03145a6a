"""The packets on the stream between server and bridge; both sides use this module.

A packet is `u32 header length, u32 body length` (big endian), a UTF-8 JSON object, then the raw body.
"""

from __future__ import annotations

import json
import struct
from collections import deque
from typing import TYPE_CHECKING, Any, NamedTuple, cast

from ros2_mcp_common.wire.limits import MAX_BODY_BYTES, MAX_HEADER_BYTES

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

_LENGTHS = struct.Struct(">II")


class PacketError(Exception):
    """Raised if the stream has no packet where one must begin, or a packet that is too large."""


class Packet(NamedTuple):
    """One packet: a JSON object and raw bytes."""

    header: dict[str, Any]
    body: bytes


def pack(header: Mapping[str, Any], body: bytes = b"") -> bytes:
    """Return the bytes of one packet. Raise `PacketError` if a part is larger than the receiver accepts."""
    text = json.dumps(header, separators=(",", ":"), allow_nan=False).encode()
    _check_lengths(len(text), len(body))
    return b"".join((_LENGTHS.pack(len(text), len(body)), text, body))


class PacketReader:
    """Collects pieces of any size and yields whole packets; each byte is copied once,
    whatever the size of the packet.
    """

    def __init__(self) -> None:
        self._parts: deque[memoryview] = deque()
        self._size = 0
        self._lengths: tuple[int, int] | None = None
        self._needed = _LENGTHS.size

    def feed(self, piece: bytes) -> Iterator[Packet]:
        """Yield the packets that this piece completes.

        Raises:
            PacketError: if the stream contains anything but packets; it cannot be read on after that.
        """
        self._parts.append(memoryview(piece))
        self._size += len(piece)
        while self._size >= self._needed:
            if self._lengths is None:
                header_length, body_length = _LENGTHS.unpack(self._take(_LENGTHS.size))
                _check_lengths(header_length, body_length)
                self._lengths, self._needed = (header_length, body_length), header_length + body_length
            else:
                text, body = map(self._take, self._lengths)
                self._lengths, self._needed = None, _LENGTHS.size
                yield Packet(_parse_header(text), body)

    @property
    def is_inside_packet(self) -> bool:
        """Whether only a part of a packet has been received."""
        return bool(self._size or self._lengths)

    def _take(self, size: int) -> bytes:
        """Remove and return the next `size` bytes received."""
        self._size -= size
        taken: list[memoryview] = []
        while size:
            part = self._parts.popleft()
            if len(part) > size:
                self._parts.appendleft(part[size:])
                part = part[:size]
            taken.append(part)
            size -= len(part)
        return b"".join(taken)


def _parse_header(text: bytes) -> dict[str, Any]:
    try:
        header: object = json.loads(text)
    except ValueError as error:
        raise PacketError(f"a packet's header is not JSON: {error}") from error
    if not isinstance(header, dict):
        raise PacketError("a packet's header is not a JSON object")
    return cast("dict[str, Any]", header)


def _check_lengths(header_length: int, body_length: int) -> None:
    if header_length > MAX_HEADER_BYTES or body_length > MAX_BODY_BYTES:
        raise PacketError(
            f"a packet of {header_length} + {body_length} bytes is larger than the limit of "
            f"{MAX_HEADER_BYTES} + {MAX_BODY_BYTES}"
        )
