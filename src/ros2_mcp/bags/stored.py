"""What is said of a topic in a bag, and which messages to read, whatever the kind of its files."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

FOREVER = 2**63 - 1
"""The largest time in nanoseconds that SQLite (and ROS) can hold: the year 2262."""


@dataclass(frozen=True, slots=True)
class StoredTopic:
    """A topic of a bag. `count` is None where only reading everything would tell.

    `encoding` (`ros2msg`, `ros2idl` or empty) and `definition` say what its bytes mean; `qos` is rosbag2's text
    about the publishers.
    """

    name: str
    type: str
    count: int | None = None
    encoding: str = ""
    definition: str = ""
    qos: str = ""
    serialization: str = "cdr"


@dataclass(frozen=True, slots=True)
class Span:
    """Which messages to read: of these topics (None: all), from `start_ns` up to but without `end_ns`."""

    topics: Collection[str] | None = None
    start_ns: int = 0
    end_ns: int = FOREVER

    def wants(self, topic: str, at_ns: int) -> bool:
        """Whether a message is one of them."""
        return self.start_ns <= at_ns < self.end_ns and (self.topics is None or topic in self.topics)
