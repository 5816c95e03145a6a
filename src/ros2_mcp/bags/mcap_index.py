"""Where things are in an MCAP file: from its index if a checksum vouches for it, else by looking through the file."""

from __future__ import annotations

import re
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import BinaryIO

from mcap.opcode import Opcode
from mcap.records import Channel

from ros2_mcp.bags import chunks
from ros2_mcp.bags.chunks import HEAD, MAGIC, ChunkPlace, Damaged, Schema

_FOOTER_BYTES = HEAD + 20 + len(MAGIC)
_MAX_SUMMARY = 1 << 29
"""Bytes. A larger index is damage: 512 MB would be one of five million chunks."""
_WINDOW = 4 << 20
"""Bytes that are searched at a time for the next chunk after damage."""
_CANDIDATE = re.compile(rb"\x06(?=.{5}\0\0\0.{28}(?:\0\0\0\0|\x04\0\0\0zstd|\x03\0\0\0lz4))", re.DOTALL)
_CANDIDATE_BYTES = 64
"""By how much windows overlap: more than the head of a chunk, which the pattern must see as a whole."""


@dataclass(slots=True)
class Index:
    """What a file holds. `loose` are places of messages outside of chunks; `counts` goes by channel.

    `problems` say in words what is damaged or missing.
    """

    schemas: dict[int, Schema] = field(default_factory=dict[int, Schema])
    channels: dict[int, Channel] = field(default_factory=dict[int, Channel])
    chunks: list[ChunkPlace] = field(default_factory=list[ChunkPlace])
    loose: list[ChunkPlace] = field(default_factory=list[ChunkPlace])
    counts: dict[int, int] | None = None
    problems: list[str] = field(default_factory=list[str])


def read_index(file: BinaryIO, size: int) -> Index:
    """The index of the file; where it has none that can be trusted, the whole file is looked through.

    Raises:
        Damaged: if it is no MCAP file at all.
    """
    try:
        found = _from_summary(file, size)
    except Damaged as damage:
        found = _Search(file, size, f"No index: {damage}.").index
    if not (found.channels or found.chunks) and _at(file, 0, len(MAGIC)) != MAGIC:
        raise Damaged("it does not begin like an MCAP file, and nothing in it is one")
    return found


def _from_summary(file: BinaryIO, size: int) -> Index:
    tail = _at(file, max(size - _FOOTER_BYTES, 0), _FOOTER_BYTES)
    if len(tail) < _FOOTER_BYTES or tail[-len(MAGIC) :] != MAGIC or chunks.head(tail) != (Opcode.FOOTER, 20):
        raise Damaged("the end of the file is missing")
    start, _, crc = (int.from_bytes(tail[HEAD + a : HEAD + b], "little") for a, b in ((0, 8), (8, 16), (16, 20)))
    end = size - _FOOTER_BYTES
    if not start <= end or not len(MAGIC) <= start or end - start > _MAX_SUMMARY:
        raise Damaged("the file was written without one" if start == 0 else "its place is wrong")
    summary = _at(file, start, end - start)
    if crc and zlib.crc32(tail[: HEAD + 16], zlib.crc32(summary)) != crc:
        raise Damaged("its checksum is wrong")
    return _read_summary(summary, start)


def _read_summary(summary: bytes, size: int) -> Index:
    found = Index()
    for kind, start, end in chunks.records_in(summary):
        content = summary[start:end]
        if kind == Opcode.CHUNK_INDEX:
            found.chunks.append(chunks.chunk_place(content))
        elif kind == Opcode.STATISTICS:
            found.counts = chunks.counts(content)
        else:
            _learn(found, kind, content)
    if found.counts is None or (sum(found.counts.values()) and not found.chunks):
        raise Damaged("it does not say where the messages are")
    if any(place.offset + place.length > size for place in found.chunks):
        raise Damaged("it speaks of places beyond the messages")
    if any(channel.schema_id not in (0, *found.schemas) for channel in found.channels.values()):
        raise Damaged("it has no definitions")
    if not found.counts.keys() <= found.channels.keys():
        raise Damaged("it does not name the topics")
    return found


def _learn(index: Index, kind: int, content: bytes) -> None:
    if kind == Opcode.SCHEMA:
        number, schema = chunks.schema(content)
        index.schemas[number] = schema
    elif kind == Opcode.CHANNEL:
        channel = chunks.channel(content)
        index.channels[channel.id] = channel


def learn_channels(index: Index, inside: bytes) -> None:
    """Takes in the schemas and channels among a chunk's records."""
    for kind, start, end in chunks.records_in(inside):
        if kind in (Opcode.SCHEMA, Opcode.CHANNEL):
            _learn(index, kind, inside[start:end])


class _Search:
    """Looks through a file from its beginning; after damage it goes on with the next chunk that is whole."""

    def __init__(self, file: BinaryIO, size: int, reason: str) -> None:
        self._file = file
        self._size = size
        self.index = Index(counts={}, problems=[reason])
        self._ended = False
        place = len(MAGIC)
        if _at(file, 0, len(MAGIC)) != MAGIC:
            self._damaged(0, "the file does not begin like an MCAP file")
        while place < size and not self._ended:
            place = self._record(place)

    def _record(self, place: int) -> int:
        """Takes in the record at that place; the place of the next one."""
        try:
            start = _at(self._file, place, HEAD)
            if len(start) < HEAD:
                raise Damaged("the file ends inside a record")
            kind, length = chunks.head(start)
            if place + HEAD + length > self._size:
                raise Damaged("a record goes beyond the end of the file")
            self._take(kind, place, length)
            return place + HEAD + length
        except Damaged as damage:
            following = self._next_chunk(place + 1)
            self._damaged(place, f"{damage}; {following - place} bytes are lost")
            return following

    def _take(self, kind: int, place: int, length: int) -> None:
        if kind == Opcode.CHUNK:
            self._take_chunk(place, length)
        elif kind in (Opcode.SCHEMA, Opcode.CHANNEL):
            _learn(self.index, kind, _at(self._file, place + HEAD, length))
        elif kind == Opcode.MESSAGE:
            self._take_loose(place, length)
        elif kind in (Opcode.DATA_END, Opcode.FOOTER):
            if length != (4 if kind == Opcode.DATA_END else 20):
                raise Damaged("the end of the messages has a wrong length")
            self._ended = True
        elif kind == Opcode.MESSAGE_INDEX:
            if length < 6 or length != 6 + int.from_bytes(_at(self._file, place + HEAD + 2, 4), "little"):
                raise Damaged("an index record has a wrong length")
        elif kind not in (Opcode.HEADER, Opcode.ATTACHMENT, Opcode.METADATA):
            raise Damaged(f"a record is of an unknown kind ({kind})")

    def _take_chunk(self, place: int, length: int) -> None:
        inside, _ = chunks.unpacked(_at(self._file, place + HEAD, length))
        keys: list[tuple[int, int]] = []
        for kind, start, end in chunks.records_in(inside):
            if kind == Opcode.MESSAGE and end - start >= 22:
                keys.append(chunks.message_key(inside, start))
        learn_channels(self.index, inside)
        self._count(keys)
        if keys:
            times = [at_ns for _, at_ns in keys]
            channels = frozenset(channel for channel, _ in keys)
            self.index.chunks.append(ChunkPlace(place, HEAD + length, min(times), max(times), channels))

    def _take_loose(self, place: int, length: int) -> None:
        if length < 22 or self.index.chunks:
            raise Damaged("a message is too short" if length < 22 else "a message is outside of the chunks")
        channel, at_ns = chunks.message_key(_at(self._file, place + HEAD, 22), 0)
        self._count([(channel, at_ns)])
        self.index.loose.append(ChunkPlace(place, HEAD + length, at_ns, at_ns, frozenset({channel})))

    def _count(self, keys: list[tuple[int, int]]) -> None:
        assert self.index.counts is not None
        for channel, _ in keys:
            self.index.counts[channel] = self.index.counts.get(channel, 0) + 1

    def _next_chunk(self, place: int) -> int:
        """The place of the next whole chunk, or the end of the file."""
        for candidate in self._candidates(place):
            _, length = chunks.head(_at(self._file, candidate, HEAD))
            if candidate + HEAD + length > self._size or length > chunks.MAX_CHUNK:
                continue
            try:
                chunks.unpacked(_at(self._file, candidate + HEAD, length))
                return candidate
            except Damaged:
                continue
        return self._size

    def _candidates(self, place: int) -> Iterator[int]:
        while place < self._size:
            window = _at(self._file, place, _WINDOW + _CANDIDATE_BYTES)
            for match in _CANDIDATE.finditer(window, 0):
                if match.start() < _WINDOW:
                    yield place + match.start()
            place += _WINDOW

    def _damaged(self, place: int, what: str) -> None:
        self.index.problems.append(f"Damage at byte {place}: {what}.")


def _at(file: BinaryIO, place: int, size: int) -> bytes:
    file.seek(place)
    return file.read(size)
