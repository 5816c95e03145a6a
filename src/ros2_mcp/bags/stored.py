"""What is said of a topic in a bag, and which messages to read, whatever the kind of its files."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

from ros2_mcp.model.text import counted, listed, named
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


@dataclass(frozen=True, slots=True)
class OddTimes:
    """What is odd about the times of a topic's messages in the order in which they were written.

    `untimed` messages are at time 0, which is none: they were recorded with a simulated time that had not begun, or
    with a clock that was not set. `backs` counts those that are older than the one before; the first of them is `by_ns`
    older, at `at_ns`, and the topic's `number`-th message (from 1; 0 where that is not known).
    """

    untimed: int = 0
    backs: int = 0
    number: int = 0
    at_ns: int = 0
    by_ns: int = 0

    def joined(self, later: OddTimes) -> OddTimes:
        """With those of a later file, whose messages have other numbers there."""
        untimed, backs = self.untimed + later.untimed, self.backs + later.backs
        if self.backs:
            return replace(self, untimed=untimed, backs=backs)
        return replace(later, untimed=untimed, number=0)

    @property
    def back_words(self) -> str:
        """Where they go back: `at message 57 by 12.3 s, to 2026-…`; empty where they do not."""
        if not self.backs:
            return ""
        first = f"at message {self.number} " if self.number else ""
        more = f", and {counted(self.backs - 1, 'time')} more" if self.backs > 1 else ""
        return f"{first}by {self.by_ns / 1e9:.4g} s, to {iso_time(self.at_ns)}{more}"

    @property
    def words(self) -> str:
        """All of it in sentences; empty where nothing is odd."""
        untimed = f"{self.untimed} of its messages have no time (0) and are left out." if self.untimed else ""
        back = f"Its times go back {self.back_words}; it is read in the order of the times." if self.backs else ""
        return f"{untimed} {back}".strip()


LEAST_BACK_NS = 1_000_000
"""Threads of a recorder that write one after the other's message turn microseconds around, which means nothing."""


def odd_times_in_words(odd: Mapping[str, OddTimes]) -> list[str]:
    """What is odd about the times of several topics, a line for each kind."""
    lines: list[str] = []
    if untimed := [f"{named(name)} {one.untimed}" for name, one in sorted(odd.items()) if one.untimed]:
        lines.append(
            f"Messages without a time (0): {listed(untimed, _MOST_NAMED)}. Span, rates and plots leave them out."
        )
    if backs := [f"{named(name)} {one.back_words}" for name, one in sorted(odd.items()) if one.backs]:
        lines.append(
            f"Times go back: {listed(backs, _MOST_NAMED)}. The clock was set while this was recorded, or parts were "
            "put together; messages are read in the order of their times."
        )
    return lines


def joined(holes: Iterable[Hole]) -> list[tuple[int, int]]:
    """The times of holes, those that overlap or touch as one, in order."""
    found: list[tuple[int, int]] = []
    for start_ns, end_ns in sorted((hole.start_ns, hole.end_ns) for hole in holes):
        if found and start_ns <= found[-1][1]:
            found[-1] = found[-1][0], max(found[-1][1], end_ns)
        else:
            found.append((start_ns, end_ns))
    return found
