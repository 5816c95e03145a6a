"""Locate chunks and channels in an MCAP file: from its index if the checksum matches, else by scanning the file."""

from __future__ import annotations

import re
import struct
import zlib
from dataclasses import dataclass, field
from typing import BinaryIO

from mcap.opcode import Opcode
from mcap.records import Channel

from ros2_mcp.bags import chunks
from ros2_mcp.bags.chunks import HEAD, MAGIC, MESSAGE_HEAD_BYTES, ChunkPlace, Damaged, Schema
from ros2_mcp.bags.stored import FOREVER, Hole

_FOOTER = struct.Struct("<QQI")  # offsets of the summary and of its own index, checksum
_FOOTER_LENGTH = 20
_FOOTER_BYTES = HEAD + _FOOTER_LENGTH + len(MAGIC)
_END_LENGTHS: dict[int, int] = {Opcode.DATA_END: 4, Opcode.FOOTER: _FOOTER_LENGTH}
_MAX_SUMMARY = 1 << 29
"""Bytes. A larger index is damage: 512 MB would be the index of five million chunks."""
_WINDOW_BYTES = 4 << 20
"""Bytes that are searched at a time for the next chunk after damage: four of this server's chunks."""
_CHUNK_HEAD = re.compile(rb"\x06(?=.{5}\0\0\0.{28}(?:\0\0\0\0|\x04\0\0\0zstd|\x03\0\0\0lz4))", re.DOTALL)
"""The head of a chunk: opcode; length, below 1 TB; times, size and checksum; and one of the three compressions there
are."""
_OVERLAP_BYTES = 64
"""Overlap of two windows: more than the head of a chunk (49 bytes), so that the pattern always sees a head as a
whole."""


@dataclass(slots=True)
class Index:
    """Contents of a file. `loose` are the places of messages outside of chunks; `counts` is by channel.

    `problems` describes what is damaged or missing; `unfinished` are those of them that every file has while it is
    being written. `holes` are the time ranges of lost messages.
    """

    schemas: dict[int, Schema] = field(default_factory=dict[int, Schema])
    channels: dict[int, Channel] = field(default_factory=dict[int, Channel])
    chunks: list[ChunkPlace] = field(default_factory=list[ChunkPlace])
    loose: list[ChunkPlace] = field(default_factory=list[ChunkPlace])
    counts: dict[int, int] | None = None
    problems: list[str] = field(default_factory=list[str])
    unfinished: list[str] = field(default_factory=list[str])
    holes: list[Hole] = field(default_factory=list[Hole])


def read_index(file: BinaryIO, size: int) -> Index:
    """Return the index of the file; if it has no valid index, scan the whole file.

    Raises:
        Damaged: if the file is not an MCAP file at all.
    """
    try:
        found = _from_summary(file, size)
    except Damaged as damage:
        found = _Search(file, size, f"No index: {damage}.", is_cut=isinstance(damage, _Cut)).index
    if not (found.channels or found.chunks) and _at(file, 0, len(MAGIC)) != MAGIC:
        raise Damaged("it is not an MCAP file")
    return found


def _from_summary(file: BinaryIO, size: int) -> Index:
    """Read the index at the end of the file; raises `Damaged` unless it is complete and fits the file."""
    end = size - _FOOTER_BYTES
    tail = _at(file, max(end, 0), _FOOTER_BYTES)
    if (
        len(tail) < _FOOTER_BYTES
        or tail[-len(MAGIC) :] != MAGIC
        or chunks.head(tail) != (Opcode.FOOTER, _FOOTER_LENGTH)
    ):
        raise _Cut("the end of the file is missing")
    start, _, crc = _FOOTER.unpack_from(tail, HEAD)
    if not len(MAGIC) <= start <= end or end - start > _MAX_SUMMARY:
        raise Damaged("the file was written without one" if start == 0 else "its place is wrong")
    summary = _at(file, start, end - start)
    if crc and zlib.crc32(tail[: HEAD + 16], zlib.crc32(summary)) != crc:
        raise Damaged("its checksum is wrong")
    found = Index()
    for kind, begin, stop in chunks.records_in(summary):
        content = summary[begin:stop]
        if kind == Opcode.CHUNK_INDEX:
            found.chunks.append(chunks.chunk_place(content))
        elif kind == Opcode.STATISTICS:
            found.counts = chunks.counts(content)
        else:
            _learn(found, kind, content)
    if found.counts is None or (sum(found.counts.values()) and not found.chunks):
        raise Damaged("it does not say where the messages are")
    if any(place.offset + place.length > start for place in found.chunks):
        raise Damaged("it refers to places beyond the messages")
    if any(channel.schema_id not in (0, *found.schemas) for channel in found.channels.values()):
        raise Damaged("it has no definitions")
    if not found.counts.keys() <= found.channels.keys():
        raise Damaged("it does not name the topics")
    return found


def _learn(index: Index, kind: int, content: bytes) -> None:
    """Add a record to the index if it is a schema or a channel."""
    if kind == Opcode.SCHEMA:
        number, schema = chunks.schema(content)
        index.schemas[number] = schema
    elif kind == Opcode.CHANNEL:
        channel = chunks.channel(content)
        index.channels[channel.id] = channel


def learn_channels(index: Index, inside: bytes | memoryview) -> None:
    """Add the schemas and channels among a chunk's records to the index."""
    for kind, start, end in chunks.records_in(inside):
        if kind in (Opcode.SCHEMA, Opcode.CHANNEL):
            _learn(index, kind, bytes(inside[start:end]))


class _Cut(Damaged):
    """Raised if the end of the file is missing, as in every file while it is being written."""


class _Search:
    """Scan a file from its beginning; after damage, continue with the next intact chunk."""

    def __init__(self, file: BinaryIO, size: int, reason: str, is_cut: bool) -> None:
        self._file = file
        self._size = size
        self._counts: dict[int, int] = {}
        self.index = Index(counts=self._counts, problems=[reason], unfinished=[reason] if is_cut else [])
        self._ended = False
        self._newest_ns = 0
        self._lost: tuple[int, str, int] | None = None  # offset, description, time before it
        if _at(file, 0, len(MAGIC)) != MAGIC:
            self._note_damage(0, "the file does not begin like an MCAP file")
        place = len(MAGIC)
        while place < size and not self._ended:
            try:
                place = self._take_record(place)
            except Damaged as damage:
                following = self._next_chunk(place + 1)
                self._note_damage(place, f"{damage}; {following - place} bytes are lost")
                place = following
        if self._lost:
            self._note_hole(FOREVER)
        elif not self._ended:
            hole = Hole(self._newest_ns, FOREVER)
            self.index.unfinished.append(f"It was not closed: {hole.words}.")
            self.index.problems.append(self.index.unfinished[-1])
            self.index.holes.append(hole)

    def _take_record(self, place: int) -> int:
        """Index the record at `place` and return the offset of the next record; raises `Damaged`."""
        start = _at(self._file, place, HEAD)
        if len(start) < HEAD:
            raise Damaged("the file ends inside a record")
        kind, length = chunks.head(start)
        if place + HEAD + length > self._size:
            raise Damaged("a record goes beyond the end of the file")
        if kind == Opcode.CHUNK:
            inside = chunks.unpacked(_at(self._file, place + HEAD, length))
            records = chunks.records_in(inside)
            keys = [
                chunks.message_key(inside, begin, end)
                for kind, begin, end in records
                if kind == Opcode.MESSAGE and end - begin >= MESSAGE_HEAD_BYTES
            ]
            learn_channels(self.index, inside)
            self._take_messages(self.index.chunks, place, length, keys)
        elif kind == Opcode.MESSAGE:
            if length < MESSAGE_HEAD_BYTES or self.index.chunks:
                is_short = length < MESSAGE_HEAD_BYTES
                raise Damaged("a message is too short" if is_short else "a message is outside of the chunks")
            key = chunks.message_key(_at(self._file, place + HEAD, MESSAGE_HEAD_BYTES), 0, MESSAGE_HEAD_BYTES)
            self._take_messages(self.index.loose, place, length, [key])
        elif kind in (Opcode.SCHEMA, Opcode.CHANNEL):
            _learn(self.index, kind, _at(self._file, place + HEAD, length))
        elif kind in _END_LENGTHS:
            if length != _END_LENGTHS[kind]:
                raise Damaged("the end of the messages has a wrong length")
            self._ended = True
        elif kind == Opcode.MESSAGE_INDEX:
            if length < 6 or length != 6 + int.from_bytes(_at(self._file, place + HEAD + 2, 4), "little"):
                raise Damaged("an index record has a wrong length")
        elif kind not in (Opcode.HEADER, Opcode.ATTACHMENT, Opcode.METADATA):
            raise Damaged(f"a record is of an unknown kind ({kind})")
        return place + HEAD + length

    def _take_messages(self, places: list[ChunkPlace], place: int, length: int, keys: list[tuple[int, int]]) -> None:
        """Add the place of a record with messages of these (channel, time) keys, and count the messages."""
        for channel, _ in keys:
            self._counts[channel] = self._counts.get(channel, 0) + 1
        if keys:
            times = [at_ns for _, at_ns in keys]
            if self._lost:
                self._note_hole(min(times))
            self._newest_ns = max(self._newest_ns, *times)
            channels = frozenset(channel for channel, _ in keys)
            places.append(ChunkPlace(place, HEAD + length, min(times), max(times), channels))

    def _next_chunk(self, place: int) -> int:
        """Return the offset of the next intact chunk, or the end of the file.

        Bytes that look like the head of a chunk may be part of a message, so each candidate is unpacked, and its
        checksum decides.
        """
        while place < self._size:
            window = _at(self._file, place, _WINDOW_BYTES + _OVERLAP_BYTES)
            for match in _CHUNK_HEAD.finditer(window):
                candidate = place + match.start()
                _, length = chunks.head(window[match.start() : match.start() + HEAD])
                if (
                    match.start() >= _WINDOW_BYTES
                    or candidate + HEAD + length > self._size
                    or length > chunks.MAX_CHUNK
                ):
                    continue
                try:
                    chunks.unpacked(_at(self._file, candidate + HEAD, length))
                    return candidate
                except Damaged:
                    continue
            place += _WINDOW_BYTES
        return self._size

    def _note_damage(self, place: int, what: str) -> None:
        """Note damage at `place`. The lost time range is known only when the next messages are found."""
        if self._lost:
            place, what = self._lost[0], f"{self._lost[1]}, and at byte {place}: {what}"
        self._lost = place, what, self._newest_ns

    def _note_hole(self, next_ns: int) -> None:
        if self._lost:
            place, what, since_ns = self._lost
            hole = Hole(since_ns, max(next_ns, since_ns))
            self.index.holes.append(hole)
            self.index.problems.append(f"Damage at byte {place}: {what}; {hole.words}.")
            self._lost = None


def _at(file: BinaryIO, place: int, size: int) -> bytes:
    file.seek(place)
    return file.read(size)
