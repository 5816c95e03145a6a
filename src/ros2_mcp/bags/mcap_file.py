"""Read one MCAP file. Every chunk is verified before any of its messages is returned."""

from __future__ import annotations

import os
import weakref
from bisect import bisect_left
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from operator import attrgetter, itemgetter
from pathlib import Path
from time import monotonic
from typing import TypeAlias

from mcap.opcode import Opcode
from mcap.records import Channel

from ros2_mcp.bags import chunks
from ros2_mcp.bags.chunks import HEAD, UNKNOWN, ChunkPlace, Damaged
from ros2_mcp.bags.contents import stored_topic
from ros2_mcp.bags.mcap_index import learn_channels, read_index
from ros2_mcp.bags.order import Written, odd_times, written
from ros2_mcp.bags.stored import MOST_PROBLEMS, Hole, OddTimes, Span, StoredTopic
from ros2_mcp.model.errors import BadData
from ros2_mcp.model.samples import Sample
from ros2_mcp.model.text import named

_Item: TypeAlias = "tuple[int, int, int, int, Sample]"
"""A message that was read: time, offset of its chunk, position in the chunk (all three are the sort key), channel,
sample."""


_LOOKED_INTO = 64
"""Number of chunks with messages at time 0 that are read to open a file. Usually only the first chunk has such
messages, from before the clock was running."""


class McapFile:
    """One MCAP file, open for reading. `times` are the Unix times (ns) of its first and last message, or None.

    Raises:
        BadData: if nothing in the file can be read.
        OSError: if the file cannot be opened.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.problems: list[str] = []
        self._file = path.open("rb")
        weakref.finalize(self, self._file.close)  # closed when no reader refers to this version of the file any more
        self._version = _version(os.fstat(self._file.fileno()))
        try:
            self._index = read_index(self._file, self._file.seek(0, 2))
        except Damaged as damage:
            self._file.close()
            raise BadData(f"{path.name} cannot be read: {damage}.") from damage
        for problem in self._index.problems:
            self._note(problem)
        self.unfinished = [f"{path.name}: {problem}" for problem in self._index.unfinished]
        self._holes: dict[int, Hole] = {}  # by the offset of the chunk
        # Keyed by the offset of the chunk; only chunks that have been read once, whose damage is noted already.
        self._read: dict[int, Mapping[int, Written]] = {}
        self._places = [*self._index.chunks, *self._index.loose]
        self._sorted: dict[bool, Sequence[ChunkPlace]] = {}  # by `newest_first`
        self.topics: Mapping[str, StoredTopic] = self._read_topics()
        self.times: tuple[int, int] | None = self._read_times()

    @property
    def is_current(self) -> bool:
        """Return whether the file is unchanged since its index was read."""
        return _version(self.path.stat()) == self._version

    @property
    def holes(self) -> list[Hole]:
        """The time ranges of lost messages, as far as they are known yet."""
        return [*self._index.holes, *self._holes.values()]

    @property
    def count(self) -> int | None:
        """Number of messages according to the index."""
        return sum((self._index.counts or {}).values())

    def counts(self) -> dict[str, int]:
        """Return the number of messages of each topic."""
        return {topic.name: topic.count or 0 for topic in self.topics.values()}

    def messages(self, span: Span, newest_first: bool = False) -> Iterator[tuple[str, Sample]]:
        """Yield topic and message in the order of time; only the chunks that are needed are read, a few at a time.

        Chunks may overlap in time. Therefore messages are held back until no following chunk can have an earlier one
        (with `newest_first`, a later one).
        """
        wanted = self._wanted(span.topics)
        sign = -1 if newest_first else 1
        waiting: list[_Item] = []
        for place in self._in_order(newest_first):
            is_in_time = place.end_ns >= span.start_ns and place.start_ns < span.end_ns
            if not is_in_time or (place.channels and place.channels.isdisjoint(wanted)):
                continue
            first = sign * (place.end_ns if newest_first else place.start_ns)
            if waiting and waiting[0][0] < first:
                ready = bisect_left(waiting, first, key=itemgetter(0))
                yield from [(wanted[item[3]], item[4]) for item in waiting[:ready]]
                del waiting[:ready]
            waiting += [
                (sign * sample.received_ns, sign * place.offset, sign * number, channel, sample)
                for number, (channel, sample) in enumerate(self._messages_at(place, span, wanted))
            ]
            waiting.sort()  # place and number are unique, so samples are never compared
        yield from [(wanted[item[3]], item[4]) for item in waiting]

    def check(self, until_s: float) -> bool:
        """Read the remaining chunks until the monotonic time `until_s` to find damage.

        Return whether all have been read.
        """
        for place in self._places:
            if place.offset not in self._read:
                if monotonic() >= until_s:
                    return False
                self._messages_at(place, Span(()), {})
        return True

    def odd_times(self, until_s: float) -> dict[str, OddTimes]:  # noqa: ARG002 - nothing is read for it
        """Return irregular message times by topic, of the chunks that have been read."""
        order = [self._read.get(place.offset) for place in sorted(self._places, key=attrgetter("offset"))]
        return odd_times(order, {number: channel.topic for number, channel in self._index.channels.items()})

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _read_times(self) -> tuple[int, int] | None:
        """Return the times of the first and last message other than time 0; reads chunks that begin at time 0."""
        first = [place.start_ns for place in self._places if place.start_ns]
        unknown = [place for place in self._places if place.end_ns and not place.start_ns]
        for place in unknown[:_LOOKED_INTO]:
            self._messages_at(place, Span(()), {})
            first += [one.least_ns for one in self._read[place.offset].values() if one.least_ns]
        first += [place.end_ns for place in unknown[_LOOKED_INTO:]]
        return (min(first), max(place.end_ns for place in self._places)) if first else None

    def _read_topics(self) -> dict[str, StoredTopic]:
        found: dict[str, StoredTopic] = {}
        for number, channel in self._index.channels.items():
            topic = self._topic_of(channel)
            count = (self._index.counts or {}).get(number, 0)
            same = found.get(topic.name)
            if same and not _is_same(same, topic):
                self._note(
                    f"{named(topic.name)}: {count} messages are left out: they are of another {named(topic.type)}."
                )
                continue
            found[topic.name] = replace(topic, count=count + (same.count or 0 if same else 0))
        return found

    def _wanted(self, topics: Collection[str] | None) -> dict[int, str]:
        """Return the channels with messages of these topics (None: all topics), and the topic of each channel."""
        return {
            number: channel.topic
            for number, channel in self._index.channels.items()
            if (topics is None or channel.topic in topics)
            and (topic := self.topics.get(channel.topic))
            and _is_same(topic, self._topic_of(channel))
        }

    def _topic_of(self, channel: Channel) -> StoredTopic:
        """Return the topic of a channel, with its type and definition."""
        schema = self._index.schemas.get(channel.schema_id, UNKNOWN)
        return stored_topic(
            channel.topic,
            schema.name,
            schema.encoding,
            schema.text,
            serialization=channel.message_encoding,
            qos=channel.metadata.get("offered_qos_profiles", ""),
        )

    def _in_order(self, newest_first: bool) -> Sequence[ChunkPlace]:
        """Return the chunks by the earliest possible time of a message, or latest first; sorted once."""
        if newest_first not in self._sorted:
            self._sorted[newest_first] = sorted(self._places, key=_by_end if newest_first else _by_start)
        return self._sorted[newest_first]

    def _messages_at(self, place: ChunkPlace, span: Span, wanted: dict[int, str]) -> list[tuple[int, Sample]]:
        """Return channel and message of a chunk's wanted messages, as written; empty if the chunk is damaged."""
        self._read.setdefault(place.offset, {})
        try:
            return self._records_at(place, span, wanted)
        except Damaged as damage:
            topics = {channel.topic for number, channel in self._index.channels.items() if number in place.channels}
            hole = Hole(place.start_ns, place.end_ns, frozenset(topics) or None)
            self._holes[place.offset] = hole
            self._note(f"Damage at byte {place.offset}: {damage}; {hole.words}.")
            return []

    def _records_at(self, place: ChunkPlace, span: Span, wanted: dict[int, str]) -> list[tuple[int, Sample]]:
        """As `_messages_at`, but raises `Damaged`.

        Channels found in the chunk are added to the index and to `wanted`.
        """
        self._file.seek(place.offset)
        data = self._file.read(place.length)
        if len(data) < HEAD or len(data) != place.length:
            raise Damaged("the file is shorter than its index says")
        kind, length = chunks.head(data)
        if kind not in (Opcode.CHUNK, Opcode.MESSAGE) or length != place.length - HEAD:
            raise Damaged("a chunk's head is wrong")
        message_kind = Opcode.MESSAGE  # looked up once: the loops below run for every message
        inside: bytes | memoryview = memoryview(data)
        places = [(HEAD, len(data))]
        if kind != message_kind:
            inside = chunks.unpacked(inside[HEAD:])
            places = [(start, end) for kind, start, end in chunks.records_in(inside) if kind == message_kind]
        keys = [chunks.message_key(inside, start, end) for start, end in places]
        if not self._read.get(place.offset):
            self._read[place.offset] = written(keys)
        known = self._index.channels
        if unknown := {channel for channel, _ in keys} - known.keys():
            if kind != message_kind:
                learn_channels(self._index, inside)
                wanted.update(self._wanted(span.topics))
            for channel in sorted(unknown - known.keys()):
                self._note(f"Messages of channel {channel} are lost: the record that names its topic is damaged.")
        return [
            chunks.message(inside, start, end)
            for (channel, at_ns), (start, end) in zip(keys, places, strict=True)
            if channel in wanted and span.start_ns <= at_ns < span.end_ns
        ]

    def _note(self, problem: str) -> None:
        text = f"{self.path.name}: {problem}"
        if len(self.problems) < MOST_PROBLEMS and text not in self.problems:
            self.problems.append(text)


def _version(facts: os.stat_result) -> tuple[int, int, int]:
    return facts.st_ino, facts.st_size, facts.st_mtime_ns


def _by_start(place: ChunkPlace) -> tuple[int, int]:
    return place.start_ns, place.offset


def _by_end(place: ChunkPlace) -> tuple[int, int]:
    return -place.end_ns, place.offset


def _is_same(topic: StoredTopic, other: StoredTopic) -> bool:
    """Return whether two channels have messages of the same type and definition; JSON needs no definition."""
    is_json = topic.form == "json"
    return topic.type == other.type and (is_json or topic.definition == other.definition)
