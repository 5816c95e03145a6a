"""Statistics of numeric fields over a capture, live or recorded."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ros2_mcp.model.errors import BadInput, BadValue, RobotError
from ros2_mcp.model.text import named
from ros2_mcp.ops.measure.flow import gaps, periods_s, rate_hz
from ros2_mcp.ops.results import Report, iso_time, silent
from ros2_mcp.ops.sources.selection import Selection
from ros2_mcp.ops.sources.source import Capture, Missing, Source, Stream

if TYPE_CHECKING:
    from ros2_mcp.codec.select import FieldPath
    from ros2_mcp.ops.measure.columns import Column, Columns

# All are subscribed to at the same time, and share the memory that a capture may take.
MAX_TOPICS = 20
# What one field takes in the result, 13 names and numbers and a short path; for how many there is room.
_FIELD_BYTES = 350
# What a topic takes beside its fields.
_TOPIC_BYTES = 500
# Fields of each topic that are shown in any case, however small the result has to be.
_MIN_FIELDS = 3
# Jumps that are listed of one field, and half of the gaps of one topic; the others are only counted.
_MAX_LISTED = 5


@dataclass(frozen=True, slots=True)
class FieldStatistics:
    """One numeric field over the time of measuring, over its finite values; null where there are too few.

    `std` is the standard deviation of the values (divided by their number), `slope` the change per second of the best
    straight line. Of an array (`array` true) all elements of all messages count together; `first`, `last`
    and `slope` are of its means. `not_finite` counts NaN and infinities. `anomalies` says in words: jumps, a stuck
    value, values that are not finite.
    """

    field: str
    array: bool
    count: int
    min: float | None = None
    max: float | None = None
    mean: float | None = None
    std: float | None = None
    first: float | None = None
    last: float | None = None
    slope: float | None = None
    constant: bool = False
    not_finite: int = 0
    anomalies: Sequence[str] = ()


@dataclass(frozen=True, slots=True)
class TopicStatistics:
    """One topic over the time of measuring. Times in seconds; null where there were too few messages to tell.

    `gaps` says in words when nothing came for longer than three median periods. `started_at` is ISO 8601.
    """

    topic_name: str
    topic_type: str = ""
    count: int = 0
    rate_hz: float | None = None
    period_median_s: float | None = None
    period_std_s: float | None = None
    gaps: Sequence[str] = ()
    fields: Sequence[FieldStatistics] = ()
    started_at: str = ""
    duration: float = 0.0
    received: int = 0
    dropped: int = 0
    lost: int | None = None
    publishers: Sequence[str] = ()
    note: str = ""
    error: str = ""

    def summary(self) -> list[str]:
        """One line, and one for each gap and anomaly."""
        if self.error:
            return [f"{named(self.topic_name)}: {self.error}"]
        rate = "rate unknown" if self.rate_hz is None else f"{self.rate_hz:.2f} Hz"
        line = f"{named(self.topic_name)}: {self.count} message(s), {rate}, {len(self.fields)} field(s). {self.note}"
        anomalies = [f"{row.field}: {anomaly}" for row in self.fields for anomaly in row.anomalies]
        return [line.rstrip(), *(f"  {finding}" for finding in (*self.gaps, *anomalies))]


@dataclass(frozen=True, slots=True)
class Statistics:
    """Several topics over the same time; an `error` of one leaves the others."""

    source: str
    topics: Sequence[TopicStatistics]

    def summary(self) -> list[str]:
        """Some lines for each topic."""
        return [line for topic in self.topics for line in topic.summary()]


async def measure(
    source: Source,
    topics: Sequence[str],
    selection: Selection,
    report: Report = silent,
) -> Statistics:
    """Statistics of the chosen fields of these topics, or of all numeric ones.

    Raises:
        BadInput: if there are no topics, too many, or one twice.
        BadValue: if the time is out of range, or a field is in none of the topics.
    """
    if not 1 <= len(topics) <= MAX_TOPICS:
        raise BadInput(f"{len(topics)} topics are given.", f"Give 1 to {MAX_TOPICS}.")
    if twice := sorted({topic for topic in topics if list(topics).count(topic) > 1}):
        raise BadInput(f"{', '.join(twice)} is given twice.", "Give each topic once.")
    if selection.fields:
        await _check_fields(source, topics, selection.fields)
    from ros2_mcp.ops.measure.columns import Columns, Room

    room = Room()

    def keep(stream: Stream) -> Columns:
        return Columns(stream.codec, stream.type, measured_fields(stream, selection.fields), room)

    captures = await source.captures(topics, keep, report)
    most_fields = max((selection.max_bytes // len(topics) - _TOPIC_BYTES) // _FIELD_BYTES, _MIN_FIELDS)

    def evaluated(capture: Capture[Columns] | Missing) -> TopicStatistics:
        if isinstance(capture, Missing):
            return TopicStatistics(capture.topic, error=str(capture.error))
        try:
            return evaluate(capture, most_fields)
        except RobotError as error:
            return TopicStatistics(capture.topic, capture.type, count=capture.kept.count, error=str(error))

    return Statistics(source.words, await asyncio.to_thread(lambda: list(map(evaluated, captures))))


def measured_fields(stream: Stream, chosen: Sequence[str]) -> list[FieldPath]:
    """The chosen fields, or all numeric ones; a chosen one that this type does not have is left out."""
    from ros2_mcp.codec.select import measurable

    if not chosen:
        return measurable(stream.codec.definitions, stream.type)
    found: list[FieldPath] = []
    for path in chosen:
        with suppress(BadValue):  # another of the topics has it
            found += measurable(stream.codec.definitions, stream.type, [path])
    return found


async def _check_fields(source: Source, topics: Sequence[str], fields: Sequence[str]) -> None:
    """Raises the error of a field that no topic has, before any time is spent on measuring."""
    from ros2_mcp.codec.select import measurable

    types: list[str] = []
    for topic in topics:
        with suppress(RobotError):  # its result will say that it is not there
            types.append(await source.type_of(topic))
    for path in fields:
        errors: list[BadValue] = []
        for type_name in types:
            try:
                measurable(source.codec.definitions, type_name, [path])
            except BadValue as error:
                errors.append(error)
        if errors and len(errors) == len(types):
            raise errors[0]


def evaluate(capture: Capture[Columns], most_fields: int = 80) -> TopicStatistics:
    """The statistics of one capture.

    Raises:
        BadData: if no message is what the type says.
    """
    import numpy as np

    kept, holes = capture.kept, capture.holes
    kept.check()
    periods = periods_s(kept.times_ns, holes)
    notes = [kept.skipped, kept.bounds("Jumps and stuck values are looked for in those")]
    if not kept.all_kept:
        until = iso_time(int(kept.times_ns[-1])) if len(kept.times_ns) else "its beginning"
        notes.append(f"Periods and gaps are those up to {until}: more times were too much to keep.")
    if not kept.columns:
        notes.insert(0, "It has no numbers to measure; choose fields for bytes, booleans and stamps.")
    elif len(kept.columns) > most_fields:
        left_out = len(kept.columns) - most_fields
        first = kept.columns[most_fields].path.path
        notes.insert(0, f"{left_out} more fields are not shown: choose fields, from {first} on.")
    if not kept.count:
        notes.insert(0, "Silent in this time." if capture.publishers else "Nobody published on it.")
    elif capture.dropped:
        notes.insert(0, f"{capture.dropped} messages were too much to keep; the newest are counted.")
    return TopicStatistics(
        capture.topic,
        capture.type,
        count=kept.count,
        rate_hz=rate_hz(kept.times_ns, holes) if kept.all_kept else kept.rate_hz,
        period_median_s=float(np.median(periods)) if len(periods) else None,
        period_std_s=float(periods.std()) if len(periods) > 1 else None,
        gaps=_gap_lines(capture),
        fields=[_field_statistics(column, capture) for column in kept.columns[:most_fields]],
        started_at=iso_time(capture.start_ns),
        duration=capture.duration_s,
        received=capture.received,
        dropped=capture.dropped,
        lost=capture.lost,
        publishers=capture.publishers,
        note=" ".join(filter(None, notes)),
    )


def _gap_lines(capture: Capture[Columns]) -> list[str]:
    kept = capture.kept
    end_ns = capture.end_ns if kept.all_kept else int(kept.times_ns[-1]) if len(kept.times_ns) else capture.start_ns
    found = gaps(kept.times_ns, capture.holes, (capture.start_ns, end_ns))
    found.sort(key=lambda gap: -gap.duration_s)
    shown = sorted(found[: 2 * _MAX_LISTED], key=lambda gap: gap.from_ns)
    lines = [
        f"nothing for {gap.duration_s:.3f} s from {(gap.from_ns - capture.start_ns) / 1e9:.3f} s on"
        f"{': damage, it cannot be read there' if gap.in_hole else ''}"
        for gap in shown
    ]
    return lines + ([f"{len(found) - len(shown)} shorter gaps"] if len(found) > len(shown) else [])


def _field_statistics(column: Column, capture: Capture[Columns]) -> FieldStatistics:
    """The statistics of one field: of a list all elements of all messages count together."""
    from ros2_mcp.ops.measure.signals import number

    totals, path = column.totals, column.path
    anomalies: list[str] = []
    if totals.not_finite:
        anomalies.append(f"{totals.not_finite} of {totals.total} values are not finite ({totals.nan} NaN)")
    if not totals.count:
        return FieldStatistics(path.path, path.is_list, 0, not_finite=totals.not_finite, anomalies=anomalies)
    return FieldStatistics(
        path.path,
        path.is_list,
        count=totals.count,
        min=number(totals.min),
        max=number(totals.max),
        mean=number(totals.mean),
        std=number(totals.std),
        first=number(column.first),
        last=number(column.last),
        slope=number(column.line.slope),
        constant=column.messages > 1 and column.is_constant,
        not_finite=totals.not_finite,
        anomalies=[] if path.is_list else [*anomalies, *_anomalies(column, capture)],
    )


def _anomalies(column: Column, capture: Capture[Columns]) -> list[str]:
    """Jumps and the time that the value stood still, in words; what lies over a hole is no jump."""
    import numpy as np

    from ros2_mcp.ops.measure import signals
    from ros2_mcp.ops.measure.columns import seconds

    values = column.values
    finite = np.isfinite(values)
    times, values = seconds(capture.kept.read_ns[column.rows], capture.start_ns)[finite], values[finite]
    holes = [((begin - capture.start_ns) / 1e9, (end - capture.start_ns) / 1e9) for begin, end in capture.holes]

    def is_over_hole(since_s: float, until_s: float) -> bool:
        return any(since_s < end_s and until_s > begin_s for begin_s, end_s in holes)

    with np.errstate(over="ignore", invalid="ignore"):  # numbers at the end of their range
        jumps, still = signals.jumps(times, values), signals.stuck(times, values)
    found = [jump for jump in jumps if not is_over_hole(jump.since_s, jump.at_s)]
    lines = [f"jump from {jump.before:g} to {jump.after:g} at {jump.at_s:.3f} s" for jump in found[:_MAX_LISTED]]
    if len(found) > _MAX_LISTED:
        lines.append(f"{len(found) - _MAX_LISTED} more jumps")
    if still:
        lines.append(f"stuck at {still.value:g} for {still.duration_s:.3f} s from {still.at_s:.3f} s on")
        if is_over_hole(still.at_s, still.at_s + still.duration_s):
            lines[-1] += " (damage: a part of that time cannot be read)"
    return lines
