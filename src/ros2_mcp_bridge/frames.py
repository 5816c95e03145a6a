"""The frames on the stream between the server and the bridge; both sides use this module.

A frame is `u32 header length, u32 body length` (big endian), a UTF-8 JSON object, then the raw body.
"""

import json
import struct

PROTOCOL = 1
MAX_HEADER_BYTES = 16 * 1024 * 1024
MAX_BODY_BYTES = 256 * 1024 * 1024

_LENGTHS = struct.Struct(">II")
LENGTHS_SIZE = _LENGTHS.size


class FrameError(Exception):
    """The stream does not carry a frame where one must begin, or one that is larger than allowed."""


def pack(header, body=b""):
    """The bytes of one frame; raises `FrameError` when a part is larger than the receiver accepts."""
    text = json.dumps(header, separators=(",", ":"), allow_nan=False).encode()
    _check_lengths(len(text), len(body))
    return b"".join((_LENGTHS.pack(len(text), len(body)), text, body))


def unpack_lengths(prefix):
    """Header and body length from the first `LENGTHS_SIZE` bytes of a frame; raises `FrameError` beyond the limits."""
    header_length, body_length = _LENGTHS.unpack(prefix)
    _check_lengths(header_length, body_length)
    return header_length, body_length


def unpack_header(text):
    """The header as a dict; raises `FrameError` when it is not a JSON object."""
    try:
        header = json.loads(text)
    except ValueError as error:
        raise FrameError(f"a frame's header is not JSON: {error}") from error
    if not isinstance(header, dict):
        raise FrameError("a frame's header is not a JSON object")
    return header


def _check_lengths(header_length, body_length):
    if header_length > MAX_HEADER_BYTES or body_length > MAX_BODY_BYTES:
        raise FrameError(
            f"a frame of {header_length} + {body_length} bytes is larger than the limit of "
            f"{MAX_HEADER_BYTES} + {MAX_BODY_BYTES}"
        )
