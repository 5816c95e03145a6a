"""What is said of a topic in a bag, and which messages to read, whatever the kind of its files."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from typing import Literal, TypeAlias

from ros2_mcp.model.text import named
from ros2_mcp.model.times import iso_time

FOREVER = 2**63 - 1
"""The largest time in nanoseconds that SQLite (and ROS) can hold: the year 2262."""
MOST_PROBLEMS = 50
"""Of one file in words. A disk that fails damages thousands of chunks, and nobody reads more than these."""
_MOST_NAMED = 5
"""Topics that are named of one hole; a chunk has those of the whole robot."""


Form: TypeAlias = Literal["ros2", "json", "other"]
"""What the bytes of a topic are: ROS 2 messages, JSON, or something that this package does not read."""


@dataclass(frozen=True, slots=True)
class StoredTopic:
    """A topic of a bag. `count` is None where only reading everything would tell.

    `form` says what its bytes are; `contents.stored_topic` decides that of what a file says. A `type` that is none of
    ROS 2 begins with the encoding: `json:app.Log`. `encoding` (`ros2msg`, `ros2idl`, `jsonschema` or empty) and
    `definition` say what the bytes mean; `qos` is rosbag2's text about the publishers.
    """

    name: str
    type: str
    count: int | None = None
    encoding: str = ""
    definition: str = ""
    qos: str = ""
    serialization: str = "cdr"
    form: Form = "ros2"


@dataclass(frozen=True, slots=True)
class Span:
    """Which messages to read: of these topics (None: all), from `start_ns` up to but without `end_ns`."""

    topics: Collection[str] | None = None
    start_ns: int = 0
    end_ns: int = FOREVER

    def wants(self, topic: str, at_ns: int) -> bool:
        """Whether a message is one of them."""
        return self.start_ns <= at_ns < self.end_ns and (self.topics is None or topic in self.topics)


@dataclass(frozen=True, slots=True)
class Hole:
    """A part of a recording that cannot be read: messages of these topics (None: it is not known of which) are lost.

    They were recorded between two Unix times in nanoseconds. 0 is a beginning and `FOREVER` an end that nobody knows.
    """

    start_ns: int
    end_ns: int
    topics: frozenset[str] | None = None

    def touches(self, topics: Collection[str] | None, start_ns: int, end_ns: int) -> bool:
        """Whether messages of these topics (None: any) may be missing between two times."""
        is_in_time = self.start_ns < end_ns and self.end_ns > start_ns
        return is_in_time and (topics is None or self.topics is None or not self.topics.isdisjoint(topics))

    @property
    def words(self) -> str:
        """What is lost: `messages from … to … are lost`."""
        of = ""
        if self.topics:
            names = sorted(self.topics)
            of = f" of {', '.join(map(named, names[:_MOST_NAMED]))}{' and others' if len(names) > _MOST_NAMED else ''}"
        if self.end_ns >= FOREVER:
            after = f"after {iso_time(self.start_ns)}" if self.start_ns else "that it had"
            return f"messages{of} {after} are lost, if there were more"
        if not self.start_ns:
            return f"messages{of} before {iso_time(self.end_ns)} are lost"
        return f"messages{of} from {iso_time(self.start_ns)} to {iso_time(self.end_ns)} are lost"


def joined(holes: Iterable[Hole]) -> list[tuple[int, int]]:
    """The times of holes, those that overlap or touch as one, in order."""
    found: list[tuple[int, int]] = []
    for start_ns, end_ns in sorted((hole.start_ns, hole.end_ns) for hole in holes):
        if found and start_ns <= found[-1][1]:
            found[-1] = found[-1][0], max(found[-1][1], end_ns)
        else:
            found.append((start_ns, end_ns))
    return found
