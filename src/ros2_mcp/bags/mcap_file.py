"""Reads one MCAP file. Every chunk is checked before a message of it is given out."""

from __future__ import annotations

import heapq
import os
import weakref
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TypeAlias

from mcap.opcode import Opcode
from mcap.records import Channel

from ros2_mcp.bags import chunks
from ros2_mcp.bags.chunks import HEAD, ChunkPlace, Damaged, MessageRecord
from ros2_mcp.bags.mcap_index import learn_channels, read_index
from ros2_mcp.bags.stored import Span, StoredTopic
from ros2_mcp.model.errors import BadData
from ros2_mcp.model.samples import Sample

_MOST_PROBLEMS = 50
"""Told of one file. A disk that fails damages thousands of chunks, and nobody reads further."""
_Key: TypeAlias = tuple[int, int, int, int]
_Item: TypeAlias = "tuple[_Key, ChunkPlace, str, Sample | None]"
_UNKNOWN = chunks.Schema("", "", "")


class McapFile:
    """One MCAP file, open for reading; as a `StoredFile`.

    Raises:
        BadData: if there is nothing in it that can be read.
        OSError: if it cannot be opened.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.problems: list[str] = []
        self._file = path.open("rb")
        weakref.finalize(self, self._file.close)  # as soon as nobody reads this state of the file any more
        self._version = _version(os.fstat(self._file.fileno()))
        self._size = self._file.seek(0, 2)
        try:
            self._index = read_index(self._file, self._size)
        except Damaged as damage:
            self._file.close()
            raise BadData(f"{path.name} cannot be read: {damage}.") from damage
        for problem in self._index.problems:
            self._note(problem)
        self._topics = self._read_topics()

    @property
    def is_current(self) -> bool:
        """Whether the file is still as it was when its index was read."""
        return _version(self.path.stat()) == self._version

    @property
    def topics(self) -> Mapping[str, StoredTopic]:
        """The topics by name."""
        return self._topics

    @property
    def times(self) -> tuple[int, int] | None:
        """Unix times of the first and the last message."""
        places = [*self._index.chunks, *self._index.loose]
        if not places:
            return None
        return min(place.start_ns for place in places), max(place.end_ns for place in places)

    @property
    def count(self) -> int | None:
        """How many messages the index speaks of."""
        return sum((self._index.counts or {}).values())

    def counts(self) -> Mapping[str, int]:
        """Messages of each topic."""
        return {topic.name: topic.count or 0 for topic in self._topics.values()}

    def messages(self, span: Span, newest_first: bool = False) -> Iterator[tuple[str, Sample]]:
        """Topic and message in the order of time; only the chunks that are needed are read, a few at a time."""
        channels = self._channels_of(span)
        places = [place for place in (*self._index.chunks, *self._index.loose) if _is_near(place, channels, span)]
        sign = -1 if newest_first else 1
        heap: list[_Item] = []
        for place in places:
            first_ns = place.end_ns if newest_first else place.start_ns
            heap.append(((sign * first_ns, 0, place.offset, 0), place, "", None))
        heapq.heapify(heap)
        while heap:
            _, place, topic, sample = heapq.heappop(heap)
            if sample is not None:
                yield topic, sample
                continue
            for number, (topic, sample) in enumerate(self._messages_at(place, span)):
                key = (sign * sample.received_ns, 1, sign * place.offset, sign * number)
                heapq.heappush(heap, (key, place, topic, sample))

    def close(self) -> None:
        """Closes the file."""
        self._file.close()

    def _read_topics(self) -> dict[str, StoredTopic]:
        found: dict[str, StoredTopic] = {}
        for number, channel in self._index.channels.items():
            schema = self._index.schemas.get(channel.schema_id, _UNKNOWN)
            count = (self._index.counts or {}).get(number, 0)
            known = found.get(channel.topic)
            if known and (known.type, known.definition) != (schema.name, schema.text):
                self._note(f"{channel.topic}: {count} messages are left out: they are of another {schema.name}.")
                continue
            found[channel.topic] = StoredTopic(
                channel.topic,
                schema.name,
                count + (known.count or 0 if known else 0),
                schema.encoding,
                schema.text,
                channel.metadata.get("offered_qos_profiles", ""),
                channel.message_encoding,
            )
        return found

    def _channels_of(self, span: Span) -> frozenset[int]:
        return frozenset(
            number
            for number, channel in self._index.channels.items()
            if span.topics is None or channel.topic in span.topics
        )

    def _messages_at(self, place: ChunkPlace, span: Span) -> list[tuple[str, Sample]]:
        """The messages of a chunk that are asked for, in the order they were written; none if it is damaged."""
        try:
            content = self._content(place)
            records = [content] if isinstance(content, MessageRecord) else self._records_in(content)
            return [message for record in records if (message := self._in_span(record, span))]
        except Damaged as damage:
            self._note(f"Damage at byte {place.offset}: {damage}; its messages are lost.")
            return []

    def _content(self, place: ChunkPlace) -> bytes | MessageRecord:
        self._file.seek(place.offset)
        data = self._file.read(place.length)
        if len(data) < HEAD or len(data) != place.length:
            raise Damaged("the file is shorter than its index says")
        kind, length = chunks.head(data)
        if kind not in (Opcode.CHUNK, Opcode.MESSAGE) or length != place.length - HEAD:
            raise Damaged("a chunk's head is wrong")
        if kind == Opcode.MESSAGE:
            return chunks.message(data, HEAD, len(data))
        return chunks.unpacked(data[HEAD:])[0]

    def _records_in(self, inside: bytes) -> list[MessageRecord]:
        message = Opcode.MESSAGE  # looked up once: this runs for every message
        found = [chunks.message(inside, a, b) for kind, a, b in chunks.records_in(inside) if kind == message]
        if any(record.channel not in self._index.channels for record in found):
            learn_channels(self._index, inside)
        return found

    def _in_span(self, record: MessageRecord, span: Span) -> tuple[str, Sample] | None:
        channel = self._index.channels.get(record.channel)
        if channel is None:
            self._note(f"Messages of channel {record.channel} are lost: the record that names its topic is damaged.")
            return None
        if not span.wants(channel.topic, record.log_ns) or not self._fits_topic(channel):
            return None
        return channel.topic, Sample(record.log_ns, record.publish_ns, record.sequence or None, record.data)

    def _fits_topic(self, channel: Channel) -> bool:
        topic = self._topics.get(channel.topic)
        schema = self._index.schemas.get(channel.schema_id, _UNKNOWN)
        return topic is not None and (topic.type, topic.definition) == (schema.name, schema.text)

    def _note(self, problem: str) -> None:
        text = f"{self.path.name}: {problem}"
        if len(self.problems) < _MOST_PROBLEMS and text not in self.problems:
            self.problems.append(text)


def _version(facts: os.stat_result) -> tuple[int, int, int]:
    return facts.st_ino, facts.st_size, facts.st_mtime_ns


def _is_near(place: ChunkPlace, channels: frozenset[int], span: Span) -> bool:
    is_in_time = place.end_ns >= span.start_ns and place.start_ns < span.end_ns
    return is_in_time and (not place.channels or bool(place.channels & channels))
