"""Parse the records of an MCAP file, and validate their bytes before use."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from typing import TypeVar

import lz4.frame
import zstandard
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile

from ros2_mcp.model.samples import Sample

MAGIC = b"\x89MCAP0\r\n"
HEAD = 9
"""Bytes before each record's content: opcode (1) and length (8)."""
MAX_CHUNK = 1 << 30
"""Bytes. No writer makes chunks of a gigabyte; a larger length is damage, and no memory is allocated for it."""
_UNDECLARED = -1
"""The size that zstd returns for data that was compressed as a stream, without its size."""
_HEAD = struct.Struct("<BQ")
_MESSAGE_HEAD = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
MESSAGE_HEAD_BYTES = _MESSAGE_HEAD.size
_CHUNK_HEAD = struct.Struct("<QQQII")  # start and end time, size, checksum, length of the compression's name
_PLACE_HEAD = struct.Struct("<QQQQI")  # start and end time, offset, length, bytes of the channels
_PLACE_CHANNEL_BYTES = 10  # per channel: its number (2 bytes) and the offset of its message index (8 bytes)
_Record = TypeVar("_Record", bound=records.McapRecord)


class Damaged(Exception):
    """Raised for bytes that are not a valid record, or differ from what was written."""


@dataclass(frozen=True, slots=True)
class Schema:
    """A type: name, encoding and definition."""

    name: str
    encoding: str
    text: str


UNKNOWN = Schema("", "", "")
"""The schema of a channel that refers to no schema."""


@dataclass(slots=True)
class ChunkPlace:
    """A chunk's offset, length in bytes, time range, and the channels in it (empty: not known)."""

    offset: int
    length: int
    start_ns: int
    end_ns: int
    channels: frozenset[int] = field(default_factory=frozenset[int])


def records_in(data: bytes | memoryview, start: int = 0, end: int | None = None) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, start and end of each record's content.

    Raises:
        Damaged: if the last record does not end where the bytes end.
    """
    end = len(data) if end is None else end
    while start < end:
        if start + HEAD > end:
            raise Damaged("it ends inside a record")
        kind, length = _HEAD.unpack_from(data, start)
        start += HEAD
        if start + length > end:
            raise Damaged("a record goes beyond its end")
        yield kind, start, start + length
        start += length


def head(data: bytes) -> tuple[int, int]:
    """Return opcode and content length of a record from its first bytes."""
    kind, length = _HEAD.unpack_from(data)
    return kind, length


def message(data: bytes | memoryview, start: int, end: int) -> tuple[int, Sample]:
    """Return channel number and sample of the message at that place; its log time is the time of receipt."""
    number, sequence, log_ns, publish_ns = _MESSAGE_HEAD.unpack_from(data, start)
    return number, Sample(log_ns, publish_ns, sequence or None, bytes(data[start + MESSAGE_HEAD_BYTES : end]))


def message_key(data: bytes | memoryview, start: int, end: int) -> tuple[int, int]:
    """Return channel number and log time (ns) of the message at that place, without copying its data."""
    if end - start < MESSAGE_HEAD_BYTES:
        raise Damaged("a message is too short")
    channel, _, log_ns, _ = _MESSAGE_HEAD.unpack_from(data, start)
    return channel, log_ns


def unpacked(content: bytes | memoryview) -> bytes | memoryview:
    """Return the records in a chunk, after its checksum, if any, was verified; uncompressed data is not copied.

    Raises:
        Damaged: if the length, size or checksum is wrong, or the data cannot be decompressed.
    """
    if len(content) < _CHUNK_HEAD.size:
        raise Damaged("a chunk is too short")
    _, _, size, crc, name_length = _CHUNK_HEAD.unpack_from(content)
    place = _CHUNK_HEAD.size + name_length
    compression = bytes(content[_CHUNK_HEAD.size : place])
    if len(content) < place + 8 or int.from_bytes(content[place : place + 8], "little") != len(content) - place - 8:
        raise Damaged("a chunk's length is wrong")
    inside = _decompressed(compression, content[place + 8 :], size)
    if len(inside) != size or (crc and zlib.crc32(inside) != crc):
        raise Damaged("a chunk's checksum is wrong" if len(inside) == size else "a chunk's size is wrong")
    return inside


def _decompressed(compression: bytes, data: bytes | memoryview, size: int) -> bytes | memoryview:
    if not compression:
        return data
    if size > _most_of(data):
        raise Damaged("a chunk's size is wrong")
    if compression == b"zstd":
        return unzstd(data, size)
    if compression != b"lz4":
        raise Damaged(f"a chunk is compressed in a way that is not known: {compression[:20]!r}")
    frame = lz4.frame.LZ4FrameDecompressor()
    try:
        inside = bytes(frame.decompress(data, max_length=size + 1))  # pyright: ignore[reportUnknownMemberType, reportUnknownArgumentType]
    except (RuntimeError, ValueError, MemoryError) as error:
        raise _not_decompressed(error) from error
    if not frame.eof:  # pyright: ignore[reportUnknownMemberType]
        raise Damaged("compressed data is of another size than its chunk says")
    return inside


def unzstd(data: bytes | memoryview, size: int | None = None) -> bytes:
    """Decompress zstd data, of `size` bytes if that is known; memory is allocated only for a plausible size.

    Raises:
        Damaged: if the data cannot be decompressed, or declares another size.
    """
    try:
        declared = zstandard.frame_content_size(data)
        if declared > _most_of(data) or (size is not None and declared not in (_UNDECLARED, size)):
            raise Damaged(f"compressed data claims to be of {declared} bytes")
        return zstandard.ZstdDecompressor().decompress(data, max_output_size=size or 0)
    except (zstandard.ZstdError, ValueError, MemoryError) as error:
        raise _not_decompressed(error) from error


def _most_of(data: bytes | memoryview) -> int:
    """Return the largest plausible decompressed size: a zstd block of 128 KiB needs at least four bytes (lz4 more)."""
    return min(MAX_CHUNK, len(data) << 15)


def _not_decompressed(error: Exception) -> Damaged:
    return Damaged(f"data cannot be decompressed: {str(error) or 'it does not fit in memory'}")


def schema(data: bytes) -> tuple[int, Schema]:
    """Return number and content of a schema record."""
    record = _read(records.Schema.read, data)
    return record.id, Schema(record.name, record.encoding, record.data.decode("utf-8", "replace"))


def channel(data: bytes) -> records.Channel:
    """Return the content of a channel record."""
    return _read(records.Channel.read, data)


def counts(data: bytes) -> dict[int, int]:
    """Return the number of messages of each channel, from a statistics record."""
    return _read(records.Statistics.read, data).channel_message_counts


def chunk_place(data: bytes) -> ChunkPlace:
    """Parse a chunk's index entry; a bag of 100 GB has 100,000 of them.

    The reader of the mcap library takes 10 µs for a chunk of five topics and 43 µs for 50; this one takes 3 µs and 25
    µs.
    """
    if len(data) < _PLACE_HEAD.size:
        raise Damaged("a record is too short")
    start_ns, end_ns, offset, length, size = _PLACE_HEAD.unpack_from(data)
    offsets = data[_PLACE_HEAD.size : _PLACE_HEAD.size + size]
    if len(offsets) < size:
        raise Damaged("a record is too short")
    channels = frozenset(int.from_bytes(offsets[at : at + 2], "little") for at in range(0, size, _PLACE_CHANNEL_BYTES))
    return ChunkPlace(offset, length, start_ns, end_ns, channels)


class _Fields(ReadDataStream):
    """The fields of one record.

    For a field beyond the end, the library's own stream returns the bytes left; this one raises.
    """

    def read(self, length: int) -> bytes:
        data = super().read(length)
        if len(data) != length:
            raise EndOfFile
        return data


def _read(read: Callable[[ReadDataStream], _Record], data: bytes) -> _Record:
    try:
        return read(_Fields(BytesIO(data)))
    except EndOfFile as error:
        raise Damaged("a record is too short") from error
    except UnicodeDecodeError as error:
        raise Damaged("a string in one of the file's records is not UTF-8") from error
