"""Recordings as other programs write them, with the library of MCAP itself and with SQLite."""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from mcap.writer import CompressionType, Writer

START_NS = 1_700_000_000 * 10**9
STEP_NS = 10**8
FLOAT = "std_msgs/msg/Float64"
STRING = "std_msgs/msg/String"


@dataclass(frozen=True)
class Channel:
    """A channel with its messages, a tenth of a second apart unless `times_ns` says otherwise."""

    topic: str
    messages: Sequence[bytes]
    type: str = FLOAT
    encoding: str = "ros2msg"
    definition: bytes = b"float64 data\n"
    serialization: str = "cdr"
    qos: str = ""
    times_ns: Sequence[int] = ()
    has_schema: bool = True


def number(value: float) -> bytes:
    """A Float64."""
    return b"\0\1\0\0" + struct.pack("<d", value)


def text(value: str) -> bytes:
    """A String."""
    data = value.encode() + b"\0"
    return b"\0\1\0\0" + struct.pack("<I", len(data)) + data


def numbers(topic: str, count: int = 5, first: float = 0.0, **more: object) -> Channel:
    """A channel of Float64 that counts."""
    return Channel(topic, [number(first + each) for each in range(count)], **more)  # type: ignore[arg-type]


def write_mcap(
    path: Path,
    *channels: Channel,
    start_ns: int = START_NS,
    compression: CompressionType = CompressionType.ZSTD,
    chunk_bytes: int = 1 << 20,
) -> Path:
    """The messages of all channels in the order of their number, whatever their times are."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as file:
        writer = Writer(file, chunk_bytes, compression)
        writer.start(profile="", library="other")
        numbers_of: list[int] = []
        for channel in channels:
            schema = (
                writer.register_schema(channel.type, channel.encoding, channel.definition) if channel.has_schema else 0
            )
            metadata = {"offered_qos_profiles": channel.qos}
            numbers_of.append(writer.register_channel(channel.topic, channel.serialization, schema, metadata))
        for index in range(max(len(channel.messages) for channel in channels)):
            for channel, of_channel in zip(channels, numbers_of, strict=True):
                if index < len(channel.messages):
                    at_ns = channel.times_ns[index] if channel.times_ns else start_ns + index * STEP_NS
                    writer.add_message(of_channel, at_ns, channel.messages[index], at_ns)
        writer.finish()
    return path


def write_db3(path: Path, topics: Iterable[tuple[str, str, Sequence[tuple[int, bytes]]]]) -> Path:
    """A database as rosbag2 of Humble writes it, without definitions: topic, type, and times with messages."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with closing(sqlite3.connect(path)) as database:
        database.executescript(
            "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, "
            "serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL);"
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL, "
            "data BLOB NOT NULL); CREATE INDEX timestamp_idx ON messages (timestamp ASC);"
        )
        for place, (name, kind, messages) in enumerate(topics, 1):
            database.execute("INSERT INTO topics VALUES (?, ?, ?, 'cdr', '')", (place, name, kind))
            for at_ns, data in messages:
                database.execute(
                    "INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)", (place, at_ns, data)
                )
        database.commit()
    return path
