"""Measure the flow of messages: rate, jitter, gaps, bandwidth and age, as `ros2 topic hz`, `bw` and `delay` do.

Only the header's stamp of a message is decoded, so that fast topics and large messages can be measured, too.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING

from ros2_mcp.model.errors import BadInput, NotFound
from ros2_mcp.model.graph import OF_EVERY_NODE
from ros2_mcp.model.names import is_hidden
from ros2_mcp.model.text import counted, listed, named
from ros2_mcp.model.times import both_times, recorded_time
from ros2_mcp.ops.measure.flow import (
    GAP_FACTOR,
    Silence,
    burst_in_words,
    gaps,
    is_burst,
    periods_s,
    silence_in,
    usual_s,
)
from ros2_mcp.ops.measure.health_check import LARGE_TYPES
from ros2_mcp.ops.results.results import (
    HIDDEN,
    SAID,
    Report,
    four_digits,
    microseconds,
    or_error,
    reporting,
    silent,
    unless_all_failed,
)
from ros2_mcp.ops.sources.from_before import FromBefore
from ros2_mcp.ops.sources.source import Capture, Missing, captured

if TYPE_CHECKING:
    from ros2_mcp.model.qos import Endpoint
    from ros2_mcp.model.samples import Sample
    from ros2_mcp.ops.sources.source import GraphSnapshot, Source
    from ros2_mcp.ops.topics.arrivals import AgedArrivals

MAX_TOPICS = 64
"""The topics of a usual robot. Each is a subscription, which the bridge serves besides all others."""
_SILENCE_S = 0.5
"""A shorter silence at the end is not reported: a slow machine makes one now and then."""
_MAX_NODES = 3
"""The most publishers that are named in a line; the table has all."""
_IRREGULAR = 2.0
"""A longest period of more than this many usual periods is reported: a message was missing there or came very late."""
_LEAST_S = 1e-3
"""A recording, or a part of a recording, that is shorter has no byte rate: it is a single moment."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicStats:
    """The traffic of one topic over a time span. Times in seconds; null if too few messages were received.

    `jitter_s` is the standard deviation of the periods. Rates have four significant digits; times are rounded to
    microseconds. `gaps` counts pauses by receive time, whatever their cause: periods longer than three times the usual
    one (the 80th percentile, so that publishers that send in pairs have no gaps), and the silence after the last
    message if it is that long and over half a second. `lost` counts messages that the middleware reports as not
    delivered, by their sequence numbers; `dropped` those that were received but discarded, because they were too many
    for this server. A pause of a sensor is a gap without a loss; a lost message may cause no gap. `age_mean_s` and
    `age_max_s` compare the header's stamp with the receive time. With several `publishers` this is the traffic of all
    of them; `publisher_nodes` names them if known. Latched messages from before are counted in `replayed` only.
    """

    topic_name: str
    topic_type: str = ""
    publishers: int = 0
    publisher_nodes: Sequence[str] = ()
    count: int = 0
    rate_hz: float | None = None
    period_mean_s: float | None = None
    period_min_s: float | None = None
    period_max_s: float | None = None
    jitter_s: float | None = None
    gaps: int = 0
    longest_gap_s: float | None = None
    bytes_per_second: float | None = 0.0
    mean_size_bytes: float | None = None
    age_mean_s: float | None = None
    age_max_s: float | None = None
    lost: int | None = None
    dropped: int = 0
    replayed: int = 0
    note: str = ""
    error: str = ""
    longest_s: float = field(default=0.0, metadata=HIDDEN)
    irregularity: float = field(default=0.0, metadata=HIDDEN)

    def summary(self) -> str:
        """Return the result in one line."""
        if self.error:
            return f"{named(self.topic_name)}: {self.error}"
        facts = ["rate unknown" if self.rate_hz is None else f"{self.rate_hz:.2f} Hz", _bytes(self.bytes_per_second)]
        if self.age_mean_s is not None:
            facts.append(f"age {self.age_mean_s:.3g} s")
        if self.irregularity > _IRREGULAR:
            facts.append(f"gaps {self.gaps}, longest {'' if self.gaps else 'period '}{self.longest_s:.3g} s")
        facts.append(counted(self.count, "message"))
        if self.publisher_nodes:
            further = len(self.publisher_nodes) - _MAX_NODES
            more = [f"{further} more"] if further > 0 else []
            facts.append(f"from {' and '.join([*map(named, self.publisher_nodes[:_MAX_NODES]), *more])}")
        if self.publishers > 1:
            facts.append(f"{self.publishers} publishers together")
        return f"{named(self.topic_name)}: {', '.join(facts)}. {self.note}".rstrip()


@dataclass(frozen=True, slots=True)
class Stats:
    """The traffic of several topics over the same time span: live, or the part of a recording that `source` names.

    The topics with the most bytes per second come first.
    """

    topics: Sequence[TopicStats]
    duration: float
    source: str = field(metadata=SAID)
    note: str = field(default="", metadata=SAID)
    is_live: bool = field(default=True, metadata=HIDDEN)

    def summary(self) -> list[str]:
        """Return a line for each topic, after a line that names the recording; and a line that names the least regular
        topic.
        """
        lines = [*(topic.summary() for topic in self.topics), *([self.note] if self.note else [])]
        worst = max(self.topics, key=lambda topic: topic.irregularity, default=None)
        if worst and worst.irregularity > _IRREGULAR and len(self.topics) > 1:
            usual_s = worst.longest_s / worst.irregularity
            longest = f"{worst.longest_s:.3g} s, {worst.irregularity:.3g} times its usual period of {usual_s:.3g} s"
            lines.append(f"Least regular: {named(worst.topic_name)}, silent for {longest}.")
        return lines if self.is_live else [f"In {self.source}:", *lines]


async def measure(source: Source, topics: Sequence[str] | None = None, report: Report = silent) -> Stats:
    """Measure several topics at once; the `error` of one topic does not stop the others.

    Without `topics`, all published topics are measured, except hidden ones and those that every node has: the first
    `MAX_TOPICS` by name, pictures and clouds before all others.

    Raises:
        BadInput: if no topic is given, or too many are.
        NotFound: if none is given and no topic has a publisher.
        AllFailed: if none could be measured.
    """
    note = ""
    if topics is None:
        topics, note = await _published(source)
    if not 1 <= len(topics) <= MAX_TOPICS:
        raise BadInput(f"{len(topics)} topics are given.", f"Give 1 to {MAX_TOPICS}.")
    if source.is_live:
        measuring = [or_error(_live(source, topic, report), partial(TopicStats, topic_name=topic)) for topic in topics]
        results = unless_all_failed(await asyncio.gather(*measuring))
    else:
        results = unless_all_failed(await _recorded(source, topics, report))
    if any(found.error for found in results):
        full = {found.topic_name: await source.name_of(found.topic_name) for found in results if found.error}
        results = _with_publishers(results, full, await source.graph())
    results = sorted(results, key=lambda found: -(found.bytes_per_second or 0.0))
    return Stats(results, round(source.duration_s, 6), source.words, note, source.is_live)


def _with_publishers(
    results: Sequence[TopicStats], full: Mapping[str, str], graph: GraphSnapshot
) -> Sequence[TopicStats]:
    """Return the results; results with an error get the topic's types and publishers, which may explain it, for
    instance several types.
    """

    def known(found: TopicStats) -> TopicStats:
        topic = graph.topics.get(full[found.topic_name]) if found.error else None
        if not topic:
            return found
        who = sorted({one.who for one in topic.publishers})
        return replace(found, topic_type=", ".join(topic.types), publishers=len(topic.publishers), publisher_nodes=who)

    return list(map(known, results))


async def _published(source: Source) -> tuple[list[str], str]:
    """Return the topics to measure if none is named, and a sentence on the topics beyond the limit."""
    graph = await source.graph()
    published = [topic for topic in graph.topics.values() if topic.publishers]
    published = [row for row in published if not is_hidden(row.topic) and row.topic not in OF_EVERY_NODE]
    if not published:
        raise NotFound(graph.absence or f"No topic in {source.title} has a publisher.", "Name the topics.")
    published.sort(key=lambda row: (not LARGE_TYPES.intersection(row.types), row.topic))
    found = [row.topic for row in published]
    left_out = found[MAX_TOPICS:]
    note = f"Not measured (at most {MAX_TOPICS} topics): {listed(left_out, MAX_TOPICS)}." if left_out else ""
    return found[:MAX_TOPICS], note


async def _live(source: Source, topic: str, report: Report) -> TopicStats:
    """Measure one topic for the whole time, which begins when the topic exists."""
    from ros2_mcp.ops.measure.columns import Room
    from ros2_mcp.ops.topics.arrivals import AgedArrivals

    async with source.follow(topic, latched=False, times_only=True) as stream:
        kept = AgedArrivals(stream, Room())
        async with reporting(report, source.duration_s, lambda: f"{topic}: {kept.count} messages"):
            held: list[Sample] = []
            async for batch in stream.batches:
                held += batch
                if stream.tells_replayed:
                    kept.add(held)
                    held = []
            kept.add(held)
        capture = captured(source, stream, kept, kept.count)
        return await asyncio.to_thread(_measured, source, capture, stream.publishers)


async def _recorded(source: Source, topics: Sequence[str], report: Report) -> list[TopicStats]:
    """Measure all topics in one pass through the recording."""
    from ros2_mcp.ops.measure.columns import Room
    from ros2_mcp.ops.topics.arrivals import AgedArrivals

    room = Room()
    captures = await source.captures(topics, lambda stream: AgedArrivals(stream, room), report)

    def measured(capture: Capture[AgedArrivals] | Missing) -> TopicStats:
        if isinstance(capture, Missing):
            return TopicStats(topic_name=capture.topic, error=str(capture.error))
        return _measured(source, capture, capture.kept.publishers)

    return await asyncio.to_thread(lambda: list(map(measured, captures)))


def _measured(source: Source, capture: Capture[AgedArrivals], publishers: Sequence[Endpoint]) -> TopicStats:
    import numpy as np

    kept, holes = capture.kept, capture.holes
    times_ns = kept.times_ns
    end_ns = capture.end_ns if kept.all_kept or not len(times_ns) else int(times_ns[-1])
    periods = periods_s(times_ns, holes)
    silence = silence_in(times_ns, end_ns, GAP_FACTOR, _SILENCE_S, holes)
    breaks_s = [gap.duration_s for gap in gaps(times_ns, holes) if not gap.in_hole]
    breaks_s += [silence.duration_s] if silence and silence.is_end else []
    longest_s = max([float(periods.max(initial=0.0)), *breaks_s])
    usual = usual_s(periods) if len(periods) else 0.0
    ages = kept.ages
    if not publishers and not kept.count:
        notes = ["It has no publisher."]
    elif not kept.count:
        notes = [f"{publishers[0].who} publishes it, but sent no message for {source.duration_s:g} s."]
    else:
        notes = [_in_words(silence, capture.zero_ns)] if silence else []
        if kept.of_other_clock:
            whose = f"{kept.of_other_clock} of its stamps" if ages else "Its stamps"
            notes.append(f"{whose} come from another clock (simulated time?), so no ages are given.")
        if kept.unstamped:
            notes.append(f"{kept.unstamped} of {kept.count} stamps are empty (0).")
    notes += [kept.goes_back] if kept.goes_back else []
    notes += [ages.trouble] if ages and ages.trouble else []
    if kept.replayed:
        notes.append(f"Not counted: {FromBefore.of(kept.replayed, kept.replayed_ns, capture.end_ns)}.")
    notes += [capture.odd_times] if capture.odd_times else []
    if not kept.all_kept:
        until = recorded_time(end_ns, capture.began_ns)
        notes.append(f"Periods and gaps cover the time up to {until}; later times did not fit in memory.")
    over_s = capture.duration_s if not source.is_live else source.duration_s
    rate = kept.rate_hz(holes)
    if rate and is_burst(kept.count, rate, over_s):
        notes.insert(0, burst_in_words(kept.count, rate))
        rate = None
    return TopicStats(
        topic_name=capture.topic,
        topic_type=capture.type,
        publishers=len(publishers),
        publisher_nodes=sorted({one.who for one in publishers}) if source.is_live else (),
        count=kept.count,
        rate_hz=four_digits(rate),
        period_mean_s=microseconds(float(periods.mean()) if len(periods) else None),
        period_min_s=microseconds(float(periods.min()) if len(periods) else None),
        period_max_s=microseconds(float(periods.max()) if len(periods) else None),
        jitter_s=microseconds(float(np.std(periods)) if len(periods) > 1 else None),
        gaps=len(breaks_s),
        longest_gap_s=microseconds(max(breaks_s, default=None)),
        bytes_per_second=four_digits(kept.bytes / over_s if over_s >= _LEAST_S else None),
        mean_size_bytes=four_digits(kept.bytes / kept.count if kept.count else None),
        age_mean_s=microseconds(ages.mean_s if ages else None),
        age_max_s=microseconds(ages.max_s if ages else None),
        lost=capture.lost,
        dropped=capture.dropped,
        replayed=kept.replayed,
        note=" ".join(notes),
        longest_s=longest_s,
        irregularity=longest_s / usual if usual and not (silence and silence.is_end) else 0.0,  # it has ended
    )


def _in_words(silence: Silence, zero_ns: int) -> str:
    since = f"from {both_times(silence.from_ns, zero_ns)} on"
    if silence.is_end:
        return f"It has stopped: no message in the last {silence.duration_s:.3g} s, {since}."
    return f"The longest silence is {silence.duration_s:.3g} s, {since}."


def _bytes(per_second: float | None) -> str:
    if per_second is None:
        return "bytes/s unknown"
    for unit, size in (("MB/s", 1e6), ("kB/s", 1e3)):
        if per_second >= size:
            return f"{per_second / size:.3g} {unit}"
    return f"{per_second:.3g} B/s"
