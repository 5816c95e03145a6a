"""Messages that were sent before this server subscribed, and were received because late subscribers get them, too.

They are never called live: every answer states their age, in these words. The stream decides which messages they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ros2_mcp.model.samples import Sample
from ros2_mcp.model.text import counted
from ros2_mcp.ops.sources.source import Source, Stream


@dataclass(frozen=True, slots=True)
class FromBefore:
    """How many of `all_of` messages are from before the subscription, and the age of the newest of these by its
    publisher's clock, in s; None if the publisher gives no time.
    """

    count: int = 0
    all_of: int = 0
    age_s: float | None = None

    @classmethod
    def of(cls, count: int, newest_ns: int, now_ns: int) -> FromBefore:
        """Return a value for `count` messages that are all from before. `newest_ns` is when
        the newest was sent (0: unknown).
        """
        return cls(count, count, max((now_ns - newest_ns) / 1e9, 0.0) if newest_ns else None)

    @classmethod
    def one(cls, age_s: float | None) -> FromBefore:
        """Return the count and age of one message that is from before; for an age of None (the message is live), a
        count of 0.
        """
        return cls() if age_s is None else cls(1, 1, age_s)

    @property
    def age(self) -> str:
        """The age in words, `8 s old, from before`; empty if there are none."""
        if not self.count:
            return ""
        return "from before" if self.age_s is None else f"{_seconds(self.age_s)} s old, from before"

    def __str__(self) -> str:
        """Return number and age, `1 message, 8 s old, from before`; empty if there are none."""
        return f"{counted(self.count, 'message')}, {self.age}" if self.count else ""

    @property
    def is_all(self) -> bool:
        """Return whether all received messages were sent before."""
        return 0 < self.count == self.all_of

    def beside(self, live: str) -> str:
        """Return the text for the origin of the messages: `live, 5 s`, or the age of all or some of them."""
        if self.is_all:
            return self.age
        return f"{live} ({self.count} of them {self.age})" if self.count else live


def from_before(source: Source, stream: Stream, samples: Sequence[Sample]) -> FromBefore:
    """Count the samples of a live stream that were sent before the call; 0 for a recording, whose messages are never
    reported as live.
    """
    if not source.is_live:
        return FromBefore()
    old = [sample for sample in samples if stream.is_replayed(sample)]
    sent_ns = max((sample.source_ns for sample in old), default=0)
    age_s = max((stream.end_ns - sent_ns) / 1e9, 0.0) if sent_ns else None
    return FromBefore(len(old), len(samples), age_s)


def outcome_in_words(*, met: bool, values: str, waited: str, from_before: str) -> str:
    """Return whether a condition was met, with its values and the time, to follow the condition; and the age of the
    message if it was sent before this call.
    """
    outcome = f"{'is met' if met else 'was not met'} {waited} ({values})"
    if not from_before:
        return outcome
    if met:
        return f"{outcome} by {from_before} this call; no newer message came"
    return f"{outcome}; the last message: {from_before} this call"


def _seconds(age_s: float) -> str:
    return f"{age_s:.0f}" if age_s >= 100 else f"{age_s:.2g}"
