"""The black box: a ring of MCAP files in one folder; the oldest files are deleted."""

from __future__ import annotations

import time
from collections.abc import Collection
from pathlib import Path
from time import monotonic

from ros2_mcp.bags.qos import is_latched
from ros2_mcp.bags.stored import StoredTopic
from ros2_mcp.bags.writer import MESSAGE_BYTES, BagWriter
from ros2_mcp.model.samples import Sample

_PARTS = 16
"""Files of a ring. When the oldest is deleted, a sixteenth is lost; more files would repeat latched messages more
often."""
_CHANNEL_BYTES = 500
"""Upper bound of the bytes that a topic needs in a file besides its messages, and its definition and QoS, which are
stored twice."""
MOST_MESSAGES = 32
"""Messages kept of one latched topic. /tf_static has one message from each driver's publisher; more than 32 are
rare."""


class LatchedTopic:
    """The last messages of a latched topic, which a late subscriber needs; equal messages are kept once.

    Several are kept, because a topic may have several publishers and a message does not say which one sent it: at most
    `MOST_MESSAGES`, taking at most `most_bytes` in a file; the last message is always kept.
    """

    def __init__(self, most_bytes: int) -> None:
        self._most_bytes = most_bytes
        self._samples: dict[bytes, Sample] = {}
        self.bytes = 0

    @property
    def samples(self) -> Collection[Sample]:
        """The messages, the oldest first."""
        return self._samples.values()

    def add(self, sample: Sample) -> None:
        """Add a message; the oldest messages are dropped if there are too many."""
        if self._samples.pop(sample.data, None) is None:
            self.bytes += _size(sample.data)
        self._samples[sample.data] = sample
        while len(self._samples) > 1 and (self.bytes > self._most_bytes or len(self._samples) > MOST_MESSAGES):
            oldest = next(iter(self._samples))
            del self._samples[oldest]
            self.bytes -= _size(oldest)


def _size(data: bytes) -> int:
    return len(data) + MESSAGE_BYTES


class RingWriter(BagWriter):
    """Keeps at most `max_bytes` and `max_age_s` of recording, including files of former runs in the folder.

    Each file takes a sixteenth of that and is complete in itself: it begins with the last messages of all latched
    topics, the smallest first, as far as they fit in half of a sixteenth. `notes` names the topics that do not fit.
    `counts` are of this run, including messages in files that have been deleted meanwhile.
    """

    def __init__(self, folder: Path, max_bytes: int, max_age_s: float) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._max_bytes = max_bytes
        self._max_age_s = max_age_s
        self._part_bytes = max(max_bytes // _PARTS, 1)
        self._latched: dict[str, LatchedTopic] = {}
        super().__init__(folder, "")

    def add_topic(self, topic: StoredTopic, type_hash: str = "") -> None:
        """Add a topic; if it is latched, every file begins with its last messages."""
        super().add_topic(topic, type_hash)
        if is_latched(topic.qos):
            self._latched.setdefault(topic.name, LatchedTopic(self._part_bytes // _PARTS))

    def write(self, topic_name: str, sample: Sample) -> None:
        """Write one message."""
        super().write(topic_name, sample)
        if topic_name in self._latched:
            self._latched[topic_name].add(sample)

    def flush(self) -> None:
        """Flush to the operating system.

        Begin the next file if this one is full or old, and delete the oldest files.
        """
        self._writer.flush()
        age_s = monotonic() - self._begun
        if self.size - self._size_before >= self._part_bytes or age_s >= self._max_age_s / _PARTS:
            self.end()
            self._open_file()

    def close(self) -> None:
        """End the file with its index. No `metadata.yaml` is written: it would list files that are deleted later."""
        self.end()

    def _open_file(self) -> None:
        carried = self._choose_carried()
        self._name = _name(time.time_ns())
        self.files.clear()  # this list would grow as long as the server runs, and only `metadata.yaml` needs it
        super()._open_file()
        self._begun = monotonic()
        for topic_name in carried:
            for sample in self._latched[topic_name].samples:
                self._put(topic_name, sample)
        self._writer.flush()
        self._size_before = self.size

    def _choose_carried(self) -> list[str]:
        """Choose the latched topics with which the next file begins, note the others, and make room for the file."""
        sizes = {
            name: _CHANNEL_BYTES + 2 * (len(topic.definition.encode()) + len(topic.qos)) + self._latched[name].bytes
            for name, topic in self.topics.items()
            if name in self._latched and self._latched[name].samples
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
        self._make_room(self._part_bytes + needed)
        return carried

    def _make_room(self, needed: int) -> None:
        """Delete the oldest files, also of former runs, until `needed` bytes fit and no file is too old."""
        files = sorted(self.folder.glob("box_*.mcap"), key=lambda path: (path.stat().st_mtime_ns, path.name))
        oldest = time.time() - self._max_age_s
        self.bytes_before = sum(path.stat().st_size for path in files)
        for path in files:
            if self.bytes_before + needed <= self._max_bytes and path.stat().st_mtime >= oldest:
                break
            self.bytes_before -= path.stat().st_size
            path.unlink()


def _name(at_ns: int) -> str:
    """Return a file name that sorts by time; both parts come from one reading of the clock."""
    seconds, rest_ns = divmod(at_ns, 1_000_000_000)
    return time.strftime("box_%Y%m%dT%H%M%S", time.gmtime(seconds)) + f"_{rest_ns:09d}"
