"""Topics of a bag, time ranges to read, and defects found, for all kinds of files."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

from ros2_mcp.model.text import counted, listed, named
from ros2_mcp.model.times import iso_time

FOREVER = 2**63 - 1
"""The largest time in nanoseconds that SQLite (and ROS) can store: the year 2262."""
MOST_PROBLEMS = 50
"""Problems that are reported of one file. A failing disk damages thousands of chunks, and a reader needs no more than
these."""
_MOST_NAMED = 5
"""Topics that are named of one hole; a chunk has those of the whole robot."""


Form: TypeAlias = Literal["ros2", "json", "other"]
"""The content of a topic's bytes: ROS 2 messages, JSON, or a format that this package does not read."""


@dataclass(frozen=True, slots=True)
class StoredTopic:
    """A topic of a bag. `count` is None if only reading the whole file would show it.

    `form` is the format of its bytes, as decided by `contents.stored_topic`. A `type` that is not a ROS 2 type begins
    with the encoding: `json:app.Log`. `encoding` (`ros2msg`, `ros2idl`, `jsonschema` or empty) and `definition`
    describe the fields; `qos` is rosbag2's text about the publishers.
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
    """The messages to read: of these topics (None: all), from `start_ns` to before `end_ns`."""

    topics: Collection[str] | None = None
    start_ns: int = 0
    end_ns: int = FOREVER

    def wants(self, topic: str, at_ns: int) -> bool:
        """Return whether a message is in the span."""
        return self.start_ns <= at_ns < self.end_ns and (self.topics is None or topic in self.topics)


@dataclass(frozen=True, slots=True)
class Hole:
    """A part of a recording that cannot be read, with messages of these topics (None: not known which) lost.

    Start and end are Unix times in nanoseconds. A start of 0 and an end of `FOREVER` mean that it is not known.
    """

    start_ns: int
    end_ns: int
    topics: frozenset[str] | None = None

    def touches(self, topics: Collection[str] | None, start_ns: int, end_ns: int) -> bool:
        """Return whether messages of these topics (None: any) may be missing between two times."""
        is_in_time = self.start_ns < end_ns and self.end_ns > start_ns
        return is_in_time and (topics is None or self.topics is None or not self.topics.isdisjoint(topics))

    @property
    def words(self) -> str:
        """The loss in words: `messages from … to … are lost`."""
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
    """Irregular times of a topic's messages, in the order in which they were written.

    `untimed` messages have time 0: they were recorded before simulated time began, or with a clock that was not set.
    `backs` counts messages that are older than the one before; the first of them is `by_ns` older, has time `at_ns`,
    and is the topic's `number`-th message (from 1; 0 if not known).
    """

    untimed: int = 0
    backs: int = 0
    number: int = 0
    at_ns: int = 0
    by_ns: int = 0

    def joined(self, later: OddTimes) -> OddTimes:
        """Return the sum with that of a later file, in which the positions of messages start from 0 again."""
        untimed, backs = self.untimed + later.untimed, self.backs + later.backs
        if self.backs:
            return replace(self, untimed=untimed, backs=backs)
        return replace(later, untimed=untimed, number=0)

    @property
    def back_words(self) -> str:
        """Description of times that go backwards: `at message 57 by 12.3 s, to 2026-…`; empty if they do not."""
        if not self.backs:
            return ""
        first = f"at message {self.number} " if self.number else ""
        more = f", and {counted(self.backs - 1, 'time')} more" if self.backs > 1 else ""
        return f"{first}by {self.by_ns / 1e9:.4g} s, to {iso_time(self.at_ns)}{more}"

    @property
    def words(self) -> str:
        """All irregularities in sentences; empty if there are none."""
        untimed = f"{self.untimed} of its messages have no time (0) and are left out." if self.untimed else ""
        back = f"Its times go back {self.back_words}; it is read in the order of the times." if self.backs else ""
        return f"{untimed} {back}".strip()


LEAST_BACK_NS = 1_000_000
"""The threads of a recorder may swap messages by microseconds, which is not an irregularity."""


def odd_times_in_words(odd: Mapping[str, OddTimes]) -> list[str]:
    """Describe the irregular times of several topics, one line for each kind."""
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
    """Return the time ranges of holes in order; overlapping or adjacent ranges are merged."""
    found: list[tuple[int, int]] = []
    for start_ns, end_ns in sorted((hole.start_ns, hole.end_ns) for hole in holes):
        if found and start_ns <= found[-1][1]:
            found[-1] = found[-1][0], max(found[-1][1], end_ns)
        else:
            found.append((start_ns, end_ns))
    return found
