"""How messages flow: rate, jitter, gaps, bandwidth and age, as `ros2 topic hz`, `bw` and `delay` measure them.

Of a message nothing but the header's stamp is decoded, so that fast topics and large messages can be measured, too.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from time import monotonic
from typing import TYPE_CHECKING

from ros2_mcp.model.errors import BadInput
from ros2_mcp.ops.measure.flow import GAP_FACTOR, Silence, gaps, periods_s, rate_hz, silence_in
from ros2_mcp.ops.results import HIDDEN, Report, iso_time, or_error, reporting, silent, unless_all_failed
from ros2_mcp.ops.sources.source import Capture, Missing, captured

if TYPE_CHECKING:
    from ros2_mcp.model.qos import Endpoint
    from ros2_mcp.ops.sources.source import Source
    from ros2_mcp.ops.topics.arrivals import AgedArrivals

MAX_TOPICS = 20
"""Chosen: more than a person compares. Each is a subscription, which the bridge serves beside all others."""
_SILENCE_S = 0.5
"""A shorter silence at the end is not reported: a slow machine makes one now and then."""
_OTHER_CLOCK_S = 1e6
"""A stamp that is eleven days off is not of this clock: simulated time begins at zero."""
_LEAST_S = 1e-3
"""A recording of a single message has no duration; bytes per second are then counted over this."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicStats:
    """The flow of one topic over a span. Times in seconds; null where there were too few messages to tell.

    `jitter_s` is the standard deviation of the periods. `gaps` counts periods longer than three times the median one,
    and the silence after the last message if it is that long and over half a second.
    `age_mean_s` and `age_max_s` compare the header's stamp with the time of receipt.
    """

    topic_name: str
    topic_type: str = ""
    publishers: int = 0
    count: int = 0
    rate_hz: float | None = None
    period_mean_s: float | None = None
    period_min_s: float | None = None
    period_max_s: float | None = None
    jitter_s: float | None = None
    gaps: int = 0
    longest_gap_s: float | None = None
    bytes_per_second: float = 0.0
    mean_size_bytes: float | None = None
    age_mean_s: float | None = None
    age_max_s: float | None = None
    lost: int | None = None
    dropped: int = 0
    note: str = ""
    error: str = ""

    def summary(self) -> str:
        """One line."""
        if self.error:
            return f"{self.topic_name}: {self.error}"
        rate = "rate unknown" if self.rate_hz is None else f"{self.rate_hz:.2f} Hz"
        return f"{self.topic_name}: {self.count} message(s), {rate}. {self.note}".rstrip()


@dataclass(frozen=True, slots=True)
class Stats:
    """The flow of several topics over the same span: live, or the part of a recording that `source` names."""

    topics: Sequence[TopicStats]
    duration: float
    source: str
    is_live: bool = field(default=True, metadata=HIDDEN)

    def summary(self) -> list[str]:
        """A line for each topic, after one that names the recording."""
        lines = [topic.summary() for topic in self.topics]
        return lines if self.is_live else [f"In {self.source}:", *lines]


async def measure(source: Source, topics: Sequence[str], report: Report = silent) -> Stats:
    """Measures several topics at once; the `error` of one does not end the others.

    Raises:
        BadInput: if there are no topics, or too many.
        AllFailed: if none could be measured.
    """
    if not 1 <= len(topics) <= MAX_TOPICS:
        raise BadInput(f"{len(topics)} topics are given.", f"Give 1 to {MAX_TOPICS}.")
    started = monotonic()
    if source.is_live:
        measuring = [or_error(_live(source, topic, report), partial(TopicStats, topic_name=topic)) for topic in topics]
        results = unless_all_failed(await asyncio.gather(*measuring))
    else:
        results = unless_all_failed(await _recorded(source, topics, report))
    duration_s = monotonic() - started if source.is_live else source.duration_s
    return Stats(results, round(duration_s, 6), source.words, source.is_live)


async def _live(source: Source, topic: str, report: Report) -> TopicStats:
    """Each topic for the whole time, which begins when the topic is there."""
    from ros2_mcp.ops.measure.columns import Room
    from ros2_mcp.ops.topics.arrivals import AgedArrivals

    async with source.follow(topic, latched=False) as stream:
        kept = AgedArrivals(stream, Room())
        async with reporting(report, source.duration_s, lambda: f"{topic}: {kept.count} messages"):
            async for batch in stream.batches:
                kept.add(batch)
        return _measured(source, captured(source, stream, kept, kept.count), stream.publishers)


async def _recorded(source: Source, topics: Sequence[str], report: Report) -> list[TopicStats]:
    """All topics in one go through the recording."""
    from ros2_mcp.ops.measure.columns import Room
    from ros2_mcp.ops.topics.arrivals import AgedArrivals

    room = Room()
    captures = await source.captures(topics, lambda stream: AgedArrivals(stream, room), report)
    return [
        TopicStats(topic_name=capture.topic, error=str(capture.error))
        if isinstance(capture, Missing)
        else _measured(source, capture, capture.kept.publishers)
        for capture in captures
    ]


def _measured(source: Source, capture: Capture[AgedArrivals], publishers: Sequence[Endpoint]) -> TopicStats:
    import numpy as np

    kept, holes = capture.kept, capture.holes
    times_ns = kept.times_ns
    end_ns = capture.end_ns if kept.all_kept or not len(times_ns) else int(times_ns[-1])
    periods = periods_s(times_ns, holes)
    silence = silence_in(times_ns, end_ns, GAP_FACTOR, _SILENCE_S, holes)
    breaks_s = [gap.duration_s for gap in gaps(times_ns, holes) if not gap.in_hole]
    breaks_s += [silence.duration_s] if silence and silence.is_end else []
    same_clock = bool(kept.aged) and abs(kept.age_mean_s) < _OTHER_CLOCK_S
    if not publishers and not kept.count:
        notes = ["Nobody publishes on it."]
    elif not kept.count:
        notes = [f"Published by {publishers[0].node}, but silent for {source.duration_s:g} s."]
    else:
        notes = [_in_words(silence)] if silence else []
        if kept.aged and not same_clock:
            notes.append("Its stamps are not from this clock (simulated time?), so ages are left out.")
    if not kept.all_kept:
        notes.append(f"Periods and gaps are those up to {iso_time(end_ns)}: more times were too much to keep.")
    over_s = capture.duration_s if not source.is_live else source.duration_s
    return TopicStats(
        topic_name=capture.topic,
        topic_type=capture.type,
        publishers=len(publishers),
        count=kept.count,
        rate_hz=rate_hz(times_ns, holes) if kept.all_kept else kept.rate_hz,
        period_mean_s=float(periods.mean()) if len(periods) else None,
        period_min_s=float(periods.min()) if len(periods) else None,
        period_max_s=float(periods.max()) if len(periods) else None,
        jitter_s=float(np.std(periods)) if len(periods) > 1 else None,
        gaps=len(breaks_s),
        longest_gap_s=max(breaks_s, default=None),
        bytes_per_second=kept.bytes / max(over_s, _LEAST_S),
        mean_size_bytes=kept.bytes / kept.count if kept.count else None,
        age_mean_s=kept.age_mean_s if same_clock else None,
        age_max_s=kept.age_max_s if same_clock else None,
        lost=capture.lost,
        dropped=capture.dropped,
        note=" ".join(notes),
    )


def _in_words(silence: Silence) -> str:
    if silence.is_end:
        return f"It has stopped: nothing came in the last {silence.duration_s:.3g} s."
    return f"The longest silence is {silence.duration_s:.3g} s from {iso_time(silence.from_ns)} on."
