"""How topics flow: rate, jitter, gaps, bandwidth and age, without decoding more than a header's stamp."""

from __future__ import annotations

import asyncio
import statistics
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from time import monotonic
from typing import TYPE_CHECKING

from ros2_mcp.model.errors import BadInput, RobotError
from ros2_mcp.model.samples import Sample, header_stamp_ns
from ros2_mcp.ops.measure.flow import GAP_FACTOR, Silence, gaps, rate_hz, silence_in
from ros2_mcp.ops.results import HIDDEN, Report, iso_time, reporting, silent

if TYPE_CHECKING:
    from ros2_mcp.ops.sources.source import Source, Stream

MAX_TOPICS = 20
_SILENCE_S = 0.5
"""A shorter silence at the end is not told: a slow machine makes one now and then."""
_OTHER_CLOCK_S = 1e6
"""A stamp that is eleven days off is not of this clock: simulated time begins at zero."""
_STAMP_END = 12
_LEAST_S = 1e-3


@dataclass(frozen=True, slots=True)
class TopicStats:
    """The flow of one topic over a window. Times in seconds; null where there were too few messages to tell.

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
    """The flow of several topics over the same window: live, or the part of a recording that `source` names."""

    topics: Sequence[TopicStats]
    duration: float
    source: str
    is_live: bool = field(default=True, metadata=HIDDEN)

    def summary(self) -> str:
        """A line for each topic, after one that names the recording."""
        lines = [topic.summary() for topic in self.topics]
        return "\n".join(lines if self.is_live else [f"In {self.source}:", *lines])


@dataclass(slots=True)
class Flow:
    """What is kept of each message: when it came, how big it was, and how old it said it was."""

    has_header: bool
    received_ns: list[int] = field(default_factory=list[int])
    sizes: list[int] = field(default_factory=list[int])
    ages_s: list[float] = field(default_factory=list[float])

    def add(self, sample: Sample) -> None:
        """Takes one message in."""
        self.received_ns.append(sample.received_ns)
        self.sizes.append(len(sample.data))
        if self.has_header and len(sample.data) >= _STAMP_END:
            self.ages_s.append((sample.received_ns - header_stamp_ns(sample.data)) / 1e9)


async def measure(source: Source, topics: Sequence[str], report: Report = silent) -> Stats:
    """Measures several topics at once; an `error` of one leaves the others.

    Raises:
        BadInput: if there are no topics, or too many.
    """
    if not 1 <= len(topics) <= MAX_TOPICS:
        raise BadInput(f"{len(topics)} topics are given.", f"Give 1 to {MAX_TOPICS}.")
    started = monotonic()
    results = await asyncio.gather(*(_measure_or_error(source, topic, report) for topic in topics))
    duration_s = monotonic() - started if source.is_live else source.duration_s
    return Stats(results, round(duration_s, 6), source.words, source.is_live)


async def _measure_or_error(source: Source, topic: str, report: Report) -> TopicStats:
    try:
        return await _measure(source, topic, report)
    except RobotError as error:
        return TopicStats(topic, error=str(error))


async def _measure(source: Source, topic: str, report: Report) -> TopicStats:
    async with source.follow(topic, latched=False) as stream:
        flow = Flow(has_header=stream.codec.definitions.starts_with_header(stream.type))
        async with reporting(report, source.duration_s, lambda: f"{topic}: {len(flow.sizes)} messages"):
            async for batch in stream.batches:
                for sample in batch:
                    flow.add(sample)
        return _evaluate(stream, flow, source.duration_s)


def _evaluate(stream: Stream, flow: Flow, duration_s: float) -> TopicStats:
    counts = stream.counts
    times_s = [(at_ns - flow.received_ns[0]) / 1e9 for at_ns in flow.received_ns]
    periods = [later - earlier for earlier, later in pairwise(times_s)]
    silence = silence_in(flow.received_ns, stream.end_ns, GAP_FACTOR, _SILENCE_S)
    breaks_s = [gap.duration_s for gap in gaps(times_s)]
    breaks_s += [silence.duration_s] if silence and silence.is_end else []
    same_clock = bool(flow.ages_s) and abs(statistics.fmean(flow.ages_s)) < _OTHER_CLOCK_S
    return TopicStats(
        stream.topic,
        stream.type,
        publishers=len(stream.publishers),
        count=len(flow.sizes),
        rate_hz=rate_hz(times_s),
        period_mean_s=statistics.fmean(periods) if periods else None,
        period_min_s=min(periods, default=None),
        period_max_s=max(periods, default=None),
        jitter_s=statistics.pstdev(periods) if len(periods) > 1 else None,
        gaps=len(breaks_s),
        longest_gap_s=max(breaks_s, default=None),
        bytes_per_second=sum(flow.sizes) / max(duration_s, _LEAST_S),
        mean_size_bytes=statistics.fmean(flow.sizes) if flow.sizes else None,
        age_mean_s=statistics.fmean(flow.ages_s) if same_clock else None,
        age_max_s=max(flow.ages_s) if same_clock else None,
        lost=counts.lost,
        dropped=counts.dropped,
        note=_note(stream, flow, duration_s, silence, same_clock),
    )


def _note(stream: Stream, flow: Flow, duration_s: float, silence: Silence | None, same_clock: bool) -> str:
    if not stream.publishers:
        return "Nobody publishes on it."
    if not flow.sizes:
        return f"Published by {stream.nodes[0]}, but silent for {duration_s:g} s."
    notes = [_in_words(silence)] if silence else []
    if flow.ages_s and not same_clock:
        notes.append("Its stamps are not from this clock (simulated time?), so ages are left out.")
    return " ".join(notes)


def _in_words(silence: Silence) -> str:
    if silence.is_end:
        return f"It has stopped: nothing came in the last {silence.duration_s:.3g} s."
    return f"The longest silence is {silence.duration_s:.3g} s from {iso_time(silence.from_ns)} on."
