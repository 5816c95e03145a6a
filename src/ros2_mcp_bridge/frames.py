"""The frames on the stream between the server and the bridge; both sides use this module.

A frame is `u32 header length, u32 body length` (big endian), a UTF-8 JSON object, then the raw body.
"""

from __future__ import annotations

import json
import struct
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping

PROTOCOL = 1
MAX_HEADER_BYTES = 16 * 1024 * 1024
MAX_BODY_BYTES = 256 * 1024 * 1024

_LENGTHS = struct.Struct(">II")
LENGTHS_SIZE = _LENGTHS.size


class FrameError(Exception):
    """The stream does not carry a frame where one must begin, or one that is larger than allowed."""


def pack(header: Mapping[str, Any], body: bytes = b"") -> bytes:
    """The bytes of one frame; raises `FrameError` when a part is larger than the receiver accepts."""
    text = json.dumps(header, separators=(",", ":"), allow_nan=False).encode()
    _check_lengths(len(text), len(body))
    return b"".join((_LENGTHS.pack(len(text), len(body)), text, body))


def unpack_lengths(prefix: bytes) -> tuple[int, int]:
    """Header and body length from the first `LENGTHS_SIZE` bytes of a frame; raises `FrameError` beyond the limits."""
    header_length, body_length = _LENGTHS.unpack(prefix)
    _check_lengths(header_length, body_length)
    return header_length, body_length


def unpack_header(text: bytes) -> dict[str, Any]:
    """The header as a dict; raises `FrameError` when it is not a JSON object."""
    try:
        header: Any = json.loads(text)
    except ValueError as error:
        raise FrameError(f"a frame's header is not JSON: {error}") from error
    if not isinstance(header, dict):
        raise FrameError("a frame's header is not a JSON object")
    return header  # pyright: ignore[reportUnknownVariableType]


def _check_lengths(header_length: int, body_length: int) -> None:
    if header_length > MAX_HEADER_BYTES or body_length > MAX_BODY_BYTES:
        raise FrameError(
            f"a frame of {header_length} + {body_length} bytes is larger than the limit of "
            f"{MAX_HEADER_BYTES} + {MAX_BODY_BYTES}"
        )
