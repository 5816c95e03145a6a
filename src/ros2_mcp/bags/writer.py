"""Write a recording: MCAP files in a rosbag2 folder, valid up to the last `flush` even after a crash."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from mcap.writer import CompressionType, Writer

from ros2_mcp.bags.rosbag2 import FilePart, write_metadata
from ros2_mcp.bags.stored import StoredTopic
from ros2_mcp.model.samples import Sample

CHUNK_BYTES = 1 << 20
"""Default of the mcap library. This much is lost to one damaged byte, and read to get a single message."""
_SEQUENCE_MASK = 0xFFFFFFFF
"""MCAP has 32 bits for the number of a message, ROS 64."""
MESSAGE_BYTES = 31 + 16
"""Bytes of a message besides its data: the head of its record, and its entry in the chunk's index."""
_LIBRARY = "ros2-mcp"


class _Output:
    """An unbuffered file; `whole` is its size at the last flush, up to which its records are complete."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.file = path.open("xb", buffering=0)
        self.size = 0
        self.whole = 0

    def write(self, data: bytes) -> int:
        view = memoryview(data)
        while view:
            written = self.file.write(view)
            view = view[written:]
            self.size += written
        return len(data)

    def tell(self) -> int:
        return self.size

    def flush(self) -> None:
        self.whole = self.size


class BagWriter:
    """One recording on disk. Every method that writes may raise `OSError`; use it from one thread only.

    `counts` has the number of messages of each topic, `files` the finished files, `bytes_before` their total size.
    `notes` are sentences for the reader of the recording.
    """

    def __init__(self, folder: Path, name: str, split_bytes: int = 0) -> None:
        self.folder = folder
        self.topics: dict[str, StoredTopic] = {}
        self.counts: dict[str, int] = {}
        self.files: list[FilePart] = []
        self.notes: Sequence[str] = ()
        self.bytes_before = 0
        self._name = name
        self._split_bytes = split_bytes
        self._hashes: dict[str, str] = {}
        self._open_file()

    @property
    def size(self) -> int:
        """Total bytes of all files, including messages that are not on the disk yet."""
        return self.bytes_before + max(self._output.size, self._part.bytes)

    @property
    def path(self) -> Path:
        """The file that is being written."""
        return self._output.path

    @property
    def descriptor(self) -> int:
        """The descriptor of the file that is being written, for `fsync`."""
        return self._output.file.fileno()

    def add_topic(self, topic: StoredTopic, type_hash: str = "") -> None:
        """Add a topic. Messages of it may be written from now on."""
        self.topics[topic.name] = topic
        self.counts.setdefault(topic.name, 0)
        self._hashes[topic.name] = type_hash

    def write(self, topic_name: str, sample: Sample) -> None:
        """Write one message, with its time of receipt as the log time."""
        self._put(topic_name, sample)
        self.counts[topic_name] += 1

    def flush(self) -> None:
        """Close the chunk and flush to the operating system; begin the next file if the current file is full."""
        self._writer.flush()
        if self._split_bytes and self._output.size >= self._split_bytes:
            self.end()
            self._open_file()

    def close(self) -> None:
        """End the file with its index and write `metadata.yaml`."""
        self.end()
        topics = [(replace(topic, count=self.counts[name]), self._hashes[name]) for name, topic in self.topics.items()]
        write_metadata(self.folder, topics, self.files)

    def end(self) -> None:
        """End the file with its index and sync it to the disk, without `metadata.yaml`."""
        self._writer.flush()  # before the index: if the disk has no room for that, `abandon` keeps the messages
        self._writer.finish()
        self._output.flush()
        os.fsync(self.descriptor)
        self._output.file.close()
        self.bytes_before += self._output.size
        self.files.append(self._part)
        self._output.size, self._part = 0, FilePart("")

    def abandon(self) -> None:
        """End the file at its last complete record without writing more, for a disk that accepts no more data."""
        if self._output.file.closed:  # the disk refused the next file, after this one was finished
            return
        try:
            os.ftruncate(self.descriptor, self._output.whole)
        finally:
            self._output.file.close()

    def _put(self, topic_name: str, sample: Sample) -> None:
        channel = self._channels.get(topic_name) or self._register(topic_name)
        at_ns, part = sample.received_ns, self._part
        sequence = (sample.sequence or 0) & _SEQUENCE_MASK
        self._writer.add_message(channel, at_ns, sample.data, sample.source_ns or at_ns, sequence)
        part.start_ns = min(part.start_ns, at_ns) if part.count else at_ns
        part.end_ns = max(part.end_ns, at_ns)
        part.count += 1
        part.bytes += MESSAGE_BYTES + len(sample.data)

    def _register(self, topic_name: str) -> int:
        topic = self.topics[topic_name]
        key = (topic.type, topic.definition)
        if key not in self._schemas:
            self._schemas[key] = self._writer.register_schema(topic.type, topic.encoding, topic.definition.encode())
        metadata = {"offered_qos_profiles": topic.qos, "topic_type_hash": self._hashes[topic_name]}
        channel = self._writer.register_channel(topic.name, topic.serialization, self._schemas[key], metadata)
        self._channels[topic_name] = channel
        return channel

    def _open_file(self) -> None:
        self._output = _Output(self.folder / f"{self._name}_{len(self.files)}.mcap")
        self._part = FilePart(self._output.path.name)
        # Not compressed: bytes are copied, as rosbag2 does (docs/decisions/0011-memory.md).
        self._writer = Writer(self._output, CHUNK_BYTES, CompressionType.NONE)  # pyright: ignore[reportArgumentType]
        self._writer.start("ros2", _LIBRARY)
        self._writer.flush()
        self._channels: dict[str, int] = {}
        self._schemas: dict[tuple[str, str], int] = {}


def fresh_folder(parent: Path, name: str) -> Path:
    """Make a new folder below `parent`, with a safe and unique name, and return it.

    Raises:
        OSError: if it cannot be made.
    """
    name = safe_name(name) or time.strftime("recording_%Y%m%d_%H%M%S", time.gmtime())
    parent.mkdir(parents=True, exist_ok=True)
    for number in range(1, 10_000):
        folder = parent / (name if number == 1 else f"{name}_{number}")
        try:
            folder.mkdir()
            return folder
        except FileExistsError:
            continue
    raise FileExistsError(f"{parent} has too many recordings of the name {name}")


def safe_name(name: str) -> str:
    """Return the name with only letters, digits, `-` and `_`, at most 80, so that it cannot lead out of the folder."""
    safe = re.sub("[^A-Za-z0-9-]", "_", name.strip())
    return safe.strip("_-")[:80]
