"""The black box: a ring of MCAP files in one folder, of which the oldest give way."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from time import monotonic

from ros2_mcp.bags.latched import LatchedTopic
from ros2_mcp.bags.qos import is_latched
from ros2_mcp.bags.stored import StoredTopic
from ros2_mcp.bags.writer import BagWriter
from ros2_mcp.model.samples import Sample

_PARTS = 16
"""Files of a ring. When the oldest goes, a sixteenth is lost; more files would repeat latched messages more often."""
_CHANNEL_BYTES = 500
"""At most what a topic needs in a file beside its messages, definition and QoS, all of it twice."""


class RingWriter:
    """As a `Sink` of a `Recorder`: keeps at most `max_bytes` and `max_age_s`, also of what former runs left there.

    Each file takes a sixteenth of that and stands by itself: it begins with the last messages of all latched topics,
    the smallest first, as far as they fit in half of a sixteenth. `notes` say which topics do not.
    """

    def __init__(self, folder: Path, max_bytes: int, max_age_s: float) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._folder = folder
        self._max_bytes = max_bytes
        self._max_age_s = max_age_s
        self._part_bytes = max(max_bytes // _PARTS, 1)
        self._hashes: dict[str, str] = {}
        self._latched: dict[str, LatchedTopic] = {}
        self.notes: Sequence[str] = ()
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
        """A topic that messages may follow for; of a latched one the last messages are in every file."""
        self._topics[topic.name] = topic
        if is_latched(topic.qos):
            self._latched.setdefault(topic.name, LatchedTopic(self._part_bytes // _PARTS))
        self._hashes[topic.name] = type_hash
        self.counts.setdefault(topic.name, 0)
        self._writer.add_topic(topic, type_hash)

    def write(self, topic_name: str, sample: Sample) -> None:
        """One message."""
        self._writer.write(topic_name, sample)
        self.counts[topic_name] += 1
        if topic_name in self._latched:
            self._latched[topic_name].add(sample)

    def flush(self) -> None:
        """Gives everything to the system; begins the next file where this one is full or old, and drops the oldest."""
        self._writer.flush()
        age_s = monotonic() - self._begun
        if self._writer.size - self._carried >= self._part_bytes or age_s >= self._max_age_s / _PARTS:
            self._writer.end()
            self._begin()

    def close(self) -> None:
        """Ends the file with its index."""
        self._writer.end()

    def abandon(self) -> None:
        """Ends with what is whole."""
        self._writer.abandon()

    def _begin(self) -> None:
        carried, needed = self._choose_carried()
        self._make_room(self._part_bytes + needed)
        self._writer = BagWriter(self._folder, _name(time.time_ns()))
        self._begun = monotonic()
        for topic in self._topics.values():
            self._writer.add_topic(topic, self._hashes[topic.name])
        for topic_name in carried:
            for sample in self._latched[topic_name].samples:
                self._writer.write(topic_name, sample)
        self._writer.flush()
        self._carried = self._writer.size

    def _choose_carried(self) -> tuple[list[str], int]:
        """The latched topics that the next file begins with, and the bytes that they need; the others are noted."""
        sizes = {
            name: _topic_bytes(self._topics[name]) + latched.bytes
            for name, latched in self._latched.items()
            if latched.samples
        }
        carried: list[str] = []
        needed = 0
        for name in sorted(sizes, key=lambda name: sizes[name]):
            if needed + sizes[name] > self._part_bytes // 2:
                break
            carried.append(name)
            needed += sizes[name]
        self.notes = [
            f"{name} is latched, but with {sizes[name]} bytes too large for each file of the ring to begin with it: "
            "its last messages are gone when their file is."
            for name in sorted(sizes.keys() - carried)
        ]
        return carried, needed

    def _make_room(self, needed: int) -> None:
        """Deletes files until so many bytes fit; those of former runs too."""
        files = sorted(self._folder.glob("box_*.mcap"), key=lambda path: (path.stat().st_mtime_ns, path.name))
        oldest = time.time() - self._max_age_s
        self._old_bytes = sum(path.stat().st_size for path in files)
        for path in files:
            if self._old_bytes + needed <= self._max_bytes and path.stat().st_mtime >= oldest:
                break
            self._old_bytes -= path.stat().st_size
            path.unlink()


def _name(at_ns: int) -> str:
    """Names in the order of time; both parts are of one reading of the clock."""
    seconds, rest_ns = divmod(at_ns, 1_000_000_000)
    return time.strftime("box_%Y%m%dT%H%M%S", time.gmtime(seconds)) + f"_{rest_ns:09d}"


def _topic_bytes(topic: StoredTopic) -> int:
    return _CHANNEL_BYTES + 2 * (len(topic.definition.encode()) + len(topic.qos))
