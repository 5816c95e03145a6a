"""The black box: a ring of MCAP files in one folder, of which the oldest give way."""

from __future__ import annotations

import time
from pathlib import Path
from time import monotonic

from ros2_mcp.bags.stored import StoredTopic
from ros2_mcp.bags.writer import BagWriter
from ros2_mcp.model.samples import Sample

_PARTS = 16
_LATCHED = "durability: 1"


class RingWriter:
    """As a `Sink` of a `Recorder`: keeps at most `max_bytes` and `max_age_s`, also of what former runs left there.

    Each file is a sixteenth of that and stands by itself: the last message of each latched topic is in all of them.
    """

    def __init__(self, folder: Path, max_bytes: int, max_age_s: float) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._folder = folder
        self._max_bytes = max_bytes
        self._max_age_s = max_age_s
        self._part_bytes = max(max_bytes // _PARTS, 1)
        self._hashes: dict[str, str] = {}
        self._latched: dict[str, Sample | None] = {}
        self.counts: dict[str, int] = {}
        self._topics: dict[str, StoredTopic] = {}
        self._begin()

    @property
    def size(self) -> int:
        """Bytes of all files of the ring."""
        return self._old_bytes + self._writer.size

    @property
    def descriptor(self) -> int:
        """The open file."""
        return self._writer.descriptor

    def add_topic(self, topic: StoredTopic, type_hash: str = "") -> None:
        """A topic that messages may follow for; of a latched one the last message is in every file."""
        self._topics[topic.name] = topic
        if _LATCHED in topic.qos:
            self._latched.setdefault(topic.name, None)
        self._hashes[topic.name] = type_hash
        self.counts.setdefault(topic.name, 0)
        self._writer.add_topic(topic, type_hash)

    def write(self, topic_name: str, sample: Sample) -> None:
        """One message."""
        self._writer.write(topic_name, sample)
        self.counts[topic_name] += 1
        if topic_name in self._latched:
            self._latched[topic_name] = sample

    def flush(self) -> None:
        """Gives everything to the system; begins the next file where this one is full or old, and drops the oldest."""
        self._writer.flush()
        age_s = monotonic() - self._begun
        if self._writer.size >= self._part_bytes or age_s >= self._max_age_s / _PARTS:
            self._writer.end()
            self._begin()

    def close(self) -> None:
        """Ends the file with its index."""
        self._writer.end()

    def abandon(self) -> None:
        """Ends with what is whole."""
        self._writer.abandon()

    def _begin(self) -> None:
        self._make_room()
        name = time.strftime("box_%Y%m%dT%H%M%S", time.gmtime()) + f"_{time.time_ns() % 1_000_000_000:09d}"
        self._writer = BagWriter(self._folder, name)
        self._begun = monotonic()
        for topic in self._topics.values():
            self._writer.add_topic(topic, self._hashes[topic.name])
        for topic_name, sample in self._latched.items():
            if sample is not None:
                self._writer.write(topic_name, sample)

    def _make_room(self) -> None:
        """Deletes files until a new one fits; those of former runs too."""
        files = sorted(self._folder.glob("box_*.mcap"), key=lambda path: path.stat().st_mtime)
        oldest = time.time() - self._max_age_s
        self._old_bytes = sum(path.stat().st_size for path in files)
        for path in files:
            if self._old_bytes + self._part_bytes <= self._max_bytes and path.stat().st_mtime >= oldest:
                break
            self._old_bytes -= path.stat().st_size
            path.unlink()
