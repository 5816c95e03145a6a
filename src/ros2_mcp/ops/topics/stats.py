"""How messages flow: rate, jitter, gaps, bandwidth and age, as `ros2 topic hz`, `bw` and `delay` measure them.

Of a message nothing but the header's stamp is decoded, so that fast topics and large messages can be measured, too.
"""

from __future__ import annotations

import asyncio
import statistics
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from time import monotonic
from typing import TYPE_CHECKING

from ros2_mcp.model.errors import BadInput
from ros2_mcp.model.samples import header_stamp_ns
from ros2_mcp.ops.measure.flow import GAP_FACTOR, Silence, gaps, rate_hz, silence_in
from ros2_mcp.ops.results import HIDDEN, Report, iso_time, or_error, reporting, silent, unless_all_failed

if TYPE_CHECKING:
    from ros2_mcp.ops.sources.source import Source

MAX_TOPICS = 20
"""Chosen: more than a person compares. Each is a subscription, which the bridge serves beside all others."""
_SILENCE_S = 0.5
"""A shorter silence at the end is not reported: a slow machine makes one now and then."""
_OTHER_CLOCK_S = 1e6
"""A stamp that is eleven days off is not of this clock: simulated time begins at zero."""
_STAMP_END = 12
"""Bytes up to the end of a header's stamp: 4 of the CDR encapsulation, 4 of seconds, 4 of nanoseconds."""
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
    measuring = [or_error(_measure(source, topic, report), partial(TopicStats, topic_name=topic)) for topic in topics]
    results = unless_all_failed(await asyncio.gather(*measuring))
    duration_s = monotonic() - started if source.is_live else source.duration_s
    return Stats(results, round(duration_s, 6), source.words, source.is_live)


async def _measure(source: Source, topic: str, report: Report) -> TopicStats:
    received_ns: list[int] = []
    sizes: list[int] = []
    ages_s: list[float] = []
    async with source.follow(topic, latched=False) as stream:
        has_header = stream.codec.definitions.starts_with_header(stream.type)
        async with reporting(report, source.duration_s, lambda: f"{topic}: {len(sizes)} messages"):
            async for batch in stream.batches:
                for sample in batch:
                    received_ns.append(sample.received_ns)
                    sizes.append(len(sample.data))
                    if has_header and len(sample.data) >= _STAMP_END:
                        ages_s.append((sample.received_ns - header_stamp_ns(sample.data)) / 1e9)
        times_s = [(at_ns - received_ns[0]) / 1e9 for at_ns in received_ns]
        periods = [later - earlier for earlier, later in pairwise(times_s)]
        silence = silence_in(received_ns, stream.end_ns, GAP_FACTOR, _SILENCE_S)
        breaks_s = [gap.duration_s for gap in gaps(times_s)]
        breaks_s += [silence.duration_s] if silence and silence.is_end else []
        same_clock = bool(ages_s) and abs(statistics.fmean(ages_s)) < _OTHER_CLOCK_S
        if not stream.publishers and not sizes:
            notes = ["Nobody publishes on it."]
        elif not sizes:
            notes = [f"Published by {stream.nodes[0]}, but silent for {source.duration_s:g} s."]
        else:
            notes = [_in_words(silence)] if silence else []
            if ages_s and not same_clock:
                notes.append("Its stamps are not from this clock (simulated time?), so ages are left out.")
        return TopicStats(
            topic_name=stream.topic,
            topic_type=stream.type,
            publishers=len(stream.publishers),
            count=len(sizes),
            rate_hz=rate_hz(times_s),
            period_mean_s=statistics.fmean(periods) if periods else None,
            period_min_s=min(periods, default=None),
            period_max_s=max(periods, default=None),
            jitter_s=statistics.pstdev(periods) if len(periods) > 1 else None,
            gaps=len(breaks_s),
            longest_gap_s=max(breaks_s, default=None),
            bytes_per_second=sum(sizes) / max(source.duration_s if source.is_live else stream.covered_s, _LEAST_S),
            mean_size_bytes=statistics.fmean(sizes) if sizes else None,
            age_mean_s=statistics.fmean(ages_s) if same_clock else None,
            age_max_s=max(ages_s) if same_clock else None,
            lost=stream.counts.lost,
            dropped=stream.counts.dropped,
            note=" ".join(notes),
        )


def _in_words(silence: Silence) -> str:
    if silence.is_end:
        return f"It has stopped: nothing came in the last {silence.duration_s:.3g} s."
    return f"The longest silence is {silence.duration_s:.3g} s from {iso_time(silence.from_ns)} on."
