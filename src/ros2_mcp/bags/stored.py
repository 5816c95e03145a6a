"""What every kind of bag file offers: topics, and messages as bytes in the order of time."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from ros2_mcp.model.samples import Sample

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


class StoredFile(Protocol):
    """One file of a bag. Damage never makes what is read wrong; `problems` tells of it, and grows while more is found.

    `topics` goes by name. `times` are the Unix times in nanoseconds of the first and the last message; None if there
    is none.
    """

    path: Path
    problems: list[str]
    topics: Mapping[str, StoredTopic]
    times: tuple[int, int] | None

    @property
    def count(self) -> int | None:
        """How many messages there are, as far as that is known without reading everything."""
        ...

    def counts(self) -> Mapping[str, int]:
        """Messages of each topic."""
        ...

    def messages(self, span: Span, newest_first: bool = False) -> Iterator[tuple[str, Sample]]:
        """Topic and message, in the order of time; the reverse of it with `newest_first`."""
        ...

    def close(self) -> None:
        """Closes the file."""
        ...
