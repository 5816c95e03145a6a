"""Messages that were sent before anybody listened here, and came only because late subscribers are given them, too.

They are never called live: every answer tells their age, by these words. Which they are, the stream decides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ros2_mcp.model.samples import Sample
from ros2_mcp.model.text import counted
from ros2_mcp.ops.sources.source import Source, Stream


@dataclass(frozen=True, slots=True)
class FromBefore:
    """How many of `all_of` messages are from before, and how old the newest of these is by its publisher's clock, in s;
    None where that gives none.
    """

    count: int = 0
    all_of: int = 0
    age_s: float | None = None

    @classmethod
    def of(cls, count: int, newest_ns: int, now_ns: int) -> FromBefore:
        """So many, and nothing else; the newest sent at that time (0: unknown)."""
        return cls(count, count, max((now_ns - newest_ns) / 1e9, 0.0) if newest_ns else None)

    @property
    def age(self) -> str:
        """`8 s old, from before`; empty where none is."""
        if not self.count:
            return ""
        return "from before" if self.age_s is None else f"{_seconds(self.age_s)} s old, from before"

    def __str__(self) -> str:
        """`1 message, 8 s old, from before`; empty where none is."""
        return f"{counted(self.count, 'message')}, {self.age}" if self.count else ""

    @property
    def is_all(self) -> bool:
        """Whether nothing has come but what was sent before."""
        return 0 < self.count == self.all_of

    def beside(self, live: str) -> str:
        """What is to be said where messages come from: `live, 5 s`, or how old all, or some of them are."""
        if self.is_all:
            return self.age
        return f"{live} ({self.count} of them {self.age})" if self.count else live


def from_before(source: Source, stream: Stream, samples: Sequence[Sample]) -> FromBefore:
    """Those of some samples of a live stream; of a recording nothing is called live, and none is told so."""
    if not source.is_live:
        return FromBefore()
    old = [sample for sample in samples if stream.is_replayed(sample)]
    sent_ns = max((sample.source_ns for sample in old), default=0)
    age_s = max((stream.end_ns - sent_ns) / 1e9, 0.0) if sent_ns else None
    return FromBefore(len(old), len(samples), age_s)


def _seconds(age_s: float) -> str:
    return f"{age_s:.0f}" if age_s >= 100 else f"{age_s:.2g}"
