"""The records of an MCAP file: what their bytes say, checked before it is believed."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field

import lz4.frame
import zstandard

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = range(1, 9)
ATTACHMENT, ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = range(9, 16)
HEAD = 9
"""Bytes before each record's content: its kind and its length."""
MAX_CHUNK = 1 << 30
_UNDECLARED = -1
_HEAD = struct.Struct("<BQ")
_MESSAGE_HEAD = struct.Struct("<HIQQ")
_CHUNK_HEAD = struct.Struct("<QQQII")


class Damaged(Exception):
    """Bytes that are no record, or not the ones that were written."""


@dataclass(frozen=True, slots=True)
class Schema:
    """A type: name, encoding and definition."""

    name: str
    encoding: str
    text: str


@dataclass(frozen=True, slots=True)
class Channel:
    """A topic with one type of one publisher's kind."""

    schema_id: int
    topic: str
    encoding: str
    metadata: dict[str, str]


@dataclass(frozen=True, slots=True)
class MessageRecord:
    """A message in a chunk (or outside of any)."""

    channel: int
    sequence: int
    log_ns: int
    publish_ns: int
    data: bytes


@dataclass(slots=True)
class ChunkPlace:
    """Where a chunk lies, what its times are, and which channels are in it (empty: not known)."""

    offset: int
    length: int
    start_ns: int
    end_ns: int
    channels: frozenset[int] = field(default_factory=frozenset[int])


def records(data: bytes, start: int = 0, end: int | None = None) -> Iterator[tuple[int, int, int]]:
    """Kind, begin and end of each record's content.

    Raises:
        Damaged: if the last one does not end where the bytes end.
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
    """Kind and length of a record from its first bytes."""
    kind, length = _HEAD.unpack_from(data)
    return kind, length


def message(data: bytes, start: int, end: int) -> MessageRecord:
    """The message at that place."""
    if end - start < _MESSAGE_HEAD.size:
        raise Damaged("a message is too short")
    number, sequence, log_ns, publish_ns = _MESSAGE_HEAD.unpack_from(data, start)
    return MessageRecord(number, sequence, log_ns, publish_ns, data[start + _MESSAGE_HEAD.size : end])


def message_key(data: bytes, start: int) -> tuple[int, int]:
    """Channel and time of the message at that place, without its bytes."""
    channel, _, log_ns, _ = _MESSAGE_HEAD.unpack_from(data, start)
    return channel, log_ns


def unpacked(content: bytes) -> tuple[bytes, bool]:
    """The records inside a chunk, and whether a checksum vouches for them.

    Raises:
        Damaged: if they are not what was written.
    """
    if len(content) < _CHUNK_HEAD.size:
        raise Damaged("a chunk is too short")
    _, _, size, crc, name_length = _CHUNK_HEAD.unpack_from(content)
    place = _CHUNK_HEAD.size + name_length
    compression = content[_CHUNK_HEAD.size : place]
    if len(content) < place + 8 or int.from_bytes(content[place : place + 8], "little") != len(content) - place - 8:
        raise Damaged("a chunk's length is wrong")
    inside = _decompressed(compression, content[place + 8 :], size)
    if len(inside) != size or (crc and zlib.crc32(inside) != crc):
        raise Damaged("a chunk's checksum is wrong" if len(inside) == size else "a chunk's size is wrong")
    return inside, bool(crc)


def _decompressed(compression: bytes, data: bytes, size: int) -> bytes:
    if not compression:
        return data
    if size > _most_of(data):
        raise Damaged("a chunk's size is wrong")
    if compression == b"zstd":
        return unzstd(data, size)
    if compression == b"lz4":
        return _unlz4(data, size)
    raise Damaged(f"a chunk is compressed in a way that is not known: {compression[:20]!r}")


def unzstd(data: bytes, size: int | None = None) -> bytes:
    """What was compressed, of `size` bytes if that is known; memory is taken only for a size that can be right.

    Raises:
        Damaged: if it cannot be decompressed, or says of itself that it has another size.
    """
    try:
        declared = zstandard.frame_content_size(data)
        if declared > _most_of(data) or (size is not None and declared not in (_UNDECLARED, size)):
            raise Damaged(f"compressed data claims to be of {declared} bytes")
        return zstandard.ZstdDecompressor().decompress(data, max_output_size=size or 0)
    except (zstandard.ZstdError, ValueError, MemoryError) as error:
        raise _not_decompressed(error) from error


def _unlz4(data: bytes, size: int) -> bytes:
    frame = lz4.frame.LZ4FrameDecompressor()
    try:
        inside = bytes(frame.decompress(data, max_length=size + 1))  # pyright: ignore[reportUnknownMemberType, reportUnknownArgumentType]
    except (RuntimeError, ValueError, MemoryError) as error:
        raise _not_decompressed(error) from error
    if not frame.eof:  # pyright: ignore[reportUnknownMemberType]
        raise Damaged("compressed data is of another size than its chunk says")
    return inside


def _most_of(data: bytes) -> int:
    """Bytes that can come of compressed ones: a block of 128 KiB needs at least four (zstd; more with lz4)."""
    return min(MAX_CHUNK, len(data) << 15)


def _not_decompressed(error: Exception) -> Damaged:
    return Damaged(f"data cannot be decompressed: {str(error) or 'it does not fit in memory'}")


class Content:
    """Reads the fields of one record, one after the other; raises `Damaged` where they do not fit."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    def number(self, size: int) -> int:
        """An unsigned integer of that many bytes."""
        return int.from_bytes(self._take(size), "little")

    def raw(self) -> bytes:
        """Bytes with their length before them."""
        return self._take(self.number(4))

    def text(self) -> str:
        """A text with its length before it."""
        try:
            return self.raw().decode()
        except UnicodeDecodeError as error:
            raise Damaged("a text is not UTF-8") from error

    def is_at_end(self) -> bool:
        """Whether all has been read."""
        return self._at == len(self._data)

    def _take(self, size: int) -> bytes:
        taken = self._data[self._at : self._at + size]
        if len(taken) != size:
            raise Damaged("a record is too short")
        self._at += size
        return taken


def schema(data: bytes) -> tuple[int, Schema]:
    """Number and content of a schema record."""
    content = Content(data)
    number = content.number(2)
    name, encoding, raw = content.text(), content.text(), content.raw()
    return number, Schema(name, encoding, raw.decode("utf-8", "replace"))


def channel(data: bytes) -> tuple[int, Channel]:
    """Number and content of a channel record."""
    content = Content(data)
    number, schema_id = content.number(2), content.number(2)
    topic, encoding = content.text(), content.text()
    return number, Channel(schema_id, topic, encoding, _texts(content.raw()))


def _texts(data: bytes) -> dict[str, str]:
    content = Content(data)
    found: dict[str, str] = {}
    while not content.is_at_end():
        key = content.text()
        found[key] = content.text()
    return found


def chunk_place(data: bytes) -> ChunkPlace:
    """A chunk's entry in the index."""
    content = Content(data)
    start_ns, end_ns, offset, length = (content.number(8) for _ in range(4))
    offsets = content.raw()
    channels = frozenset(int.from_bytes(offsets[at : at + 2], "little") for at in range(0, len(offsets), 10))
    return ChunkPlace(offset, length, start_ns, end_ns, channels)


def counts(data: bytes) -> dict[int, int]:
    """Messages of each channel, from a statistics record."""
    content = Content(data)
    for size in (8, 2, 4, 4, 4, 4, 8, 8):
        content.number(size)
    table = Content(content.raw())
    found: dict[int, int] = {}
    while not table.is_at_end():
        number = table.number(2)
        found[number] = table.number(8)
    return found
