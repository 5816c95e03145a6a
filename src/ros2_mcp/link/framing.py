"""Frames out of a stream of bytes that arrives in pieces of any size."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

from ros2_mcp_bridge import frames


class Frame(NamedTuple):
    """One frame of the stream: a JSON object and raw bytes."""

    header: dict[str, Any]
    body: bytes


class FrameReader:
    """Collects pieces and yields whole frames; each byte is copied twice, however large the frame is."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, piece: bytes) -> Iterator[Frame]:
        """The frames that this piece completes.

        Raises:
            FrameError: if the stream carries anything but frames; nothing after that can be understood.
        """
        self._buffer += piece
        while len(self._buffer) >= frames.LENGTHS_SIZE:
            header_length, body_length = _lengths(self._buffer)
            begin = frames.LENGTHS_SIZE + header_length
            end = begin + body_length
            if len(self._buffer) < end:
                return
            with memoryview(self._buffer) as view:
                header, body = bytes(view[frames.LENGTHS_SIZE : begin]), bytes(view[begin:end])
            del self._buffer[:end]
            yield Frame(_header(header), body)


def pack(header: dict[str, Any], body: bytes = b"") -> bytes:
    """The bytes of one frame; raises `FrameError` when a part is larger than the receiver accepts."""
    return frames.pack(header, body)  # pyright: ignore[reportUnknownMemberType]


def _lengths(buffer: bytearray) -> tuple[int, int]:
    return frames.unpack_lengths(bytes(buffer[: frames.LENGTHS_SIZE]))


def _header(text: bytes) -> dict[str, Any]:
    return frames.unpack_header(text)
