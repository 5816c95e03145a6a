"""Statistics of numeric fields over a capture, live or recorded."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from ros2_mcp.model.errors import BadInput, BadValue, RobotError
from ros2_mcp.model.text import counted, named
from ros2_mcp.model.times import both_times, recorded_time, seconds_from_start
from ros2_mcp.ops.measure.flow import burst_in_words, gaps, is_burst, periods_s
from ros2_mcp.ops.results.results import Report, four_digits, iso_time, microseconds, silent
from ros2_mcp.ops.sources.from_before import FromBefore
from ros2_mcp.ops.sources.selection import Selection
from ros2_mcp.ops.sources.source import Capture, Missing, Source, Stream

if TYPE_CHECKING:
    from ros2_mcp.ops.measure.columns import Column, Columns, Extreme
    from ros2_mcp.values.select import FieldPath

# The most topics of one call: all are subscribed to at the same time and share the memory of a capture.
MAX_TOPICS = 20
# Bytes of one field in the result (15 names and numbers, two times and a short path), to compute how many fit.
_FIELD_BYTES = 480
# Bytes of a topic without its fields.
_TOPIC_BYTES = 500
# The least number of fields shown for each topic, however small the result must be.
_MIN_FIELDS = 3
# The most trends and constant values in the text; all are in the table.
_MAX_NAMED = 12
# Integers beyond this are not exact in JSON and are given as texts.
_EXACT = 2**53
# The most fields whose extremes have a line in the text; all are in the table.
_MAX_RANGES = 6
# The most jumps listed for one field, and half of the gaps listed for one topic; the others are only counted.
_MAX_LISTED = 5


@dataclass(frozen=True, slots=True)
class FieldStatistics:
    """One numeric field over the measured time; statistics of its finite values, null if there are too few.

    `min_at` and `max_at` give the first time of the extremes, and in an array the element. `trend` describes a change
    in one direction over the whole time. `std` is the standard deviation (divided by the number of values), `slope` the
    change per second of the least-squares line. For an array (`array` true) the elements of all messages count
    together; `first`, `last` and `slope` are those of its means. `not_finite` counts NaN and infinities. `anomalies`
    describes jumps, a stuck value, and values that are not finite.
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
    min_at: str = ""
    max_at: str = ""
    trend: str = ""
    not_finite: int = 0
    anomalies: Sequence[str] = ()

    @property
    def range(self) -> str:
        """The extremes and their times, in words."""
        extremes = (("min", self.min, self.min_at), ("max", self.max, self.max_at))
        told = [f"{name} {value:.6g} at {at}" for name, value, at in extremes if value is not None]
        return f"{self.field}: {', '.join(told)}"


@dataclass(frozen=True, slots=True)
class TopicStatistics:
    """One topic over the measured time. Times in seconds; null if there are too few messages.

    `constants` holds the fields with the same value in every message, and that value; `fields` the others. `gaps`
    describes times without messages longer than three usual periods (four of five are not longer). `started_at` is ISO
    8601; other times are absolute and in seconds from then, or from the start of a recording, which is
    `seconds_from_start` seconds earlier.
    """

    topic_name: str
    topic_type: str = ""
    count: int = 0
    rate_hz: float | None = None
    period_median_s: float | None = None
    period_std_s: float | None = None
    gaps: Sequence[str] = ()
    fields: Sequence[FieldStatistics] = ()
    constants: Mapping[str, float | str] = field(default_factory=dict[str, "float | str"])
    started_at: str = ""
    seconds_from_start: float | None = None
    duration: float = 0.0
    received: int = 0
    dropped: int = 0
    lost: int | None = None
    publishers: Sequence[str] = ()
    note: str = ""
    error: str = ""

    def summary(self) -> list[str]:
        """Return one line for the topic, and one line for each gap, anomaly, and range of the first fields."""
        if self.error:
            return [f"{named(self.topic_name)}: {self.error}"]
        rate = "rate unknown" if self.rate_hz is None else f"{self.rate_hz:.2f} Hz"
        line = (
            f"{named(self.topic_name)}: {counted(self.count, 'message')}, {rate}, {counted(len(self.fields), 'field')}."
        )
        anomalies = [f"{row.field}: {anomaly}" for row in self.fields for anomaly in row.anomalies]
        trends = [f"{row.field} {row.trend}" for row in self.fields if row.trend]
        constants = [f"{name} {_short(value)}" for name, value in self.constants.items()]
        lists = [_listed("trends", trends), _listed("constant", constants)]
        ranges = [row.range for row in self.fields[:_MAX_RANGES] if row.min is not None]
        findings = [finding for finding in (*self.gaps, *anomalies, *lists, *ranges) if finding]
        return [f"{line} {self.note}".rstrip(), *(f"  {finding}" for finding in findings)]


@dataclass(frozen=True, slots=True)
class Statistics:
    """Several topics over the same time span; an `error` concerns only its topic."""

    source: str
    topics: Sequence[TopicStatistics]

    def summary(self) -> list[str]:
        """Return the lines of each topic."""
        return [line for topic in self.topics for line in topic.summary()]


async def measure(
    source: Source,
    topics: Sequence[str],
    selection: Selection,
    report: Report = silent,
) -> Statistics:
    """Measure the chosen fields of these topics, or all numeric fields.

    Raises:
        BadInput: if there are no topics, too many, or one twice.
        BadValue: if the time is out of range, or none of the topics has a field.
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
        return Columns(
            stream.codec, stream.type, measured_fields(stream, selection.fields), room, is_replayed=stream.is_replayed
        )

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
    """Return the chosen fields, or all numeric fields; chosen fields that this type lacks are skipped."""
    from ros2_mcp.values.select import measurable

    if not chosen:
        return measurable(stream.codec.definitions, stream.type)
    found: list[FieldPath] = []
    for path in chosen:
        with suppress(BadValue):  # another of the topics may have it
            found += measurable(stream.codec.definitions, stream.type, [path])
    return found


async def _check_fields(source: Source, topics: Sequence[str], fields: Sequence[str]) -> None:
    """Raise BadValue for a field that no topic has, before any time is spent on measuring."""
    from ros2_mcp.values.select import measurable

    types: list[str] = []
    for topic in topics:
        with suppress(RobotError):  # reported in the result of that topic
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
    """Return the statistics of one capture.

    Raises:
        BadData: if no message could be decoded.
    """
    import numpy as np

    kept, holes = capture.kept, capture.holes
    kept.check()
    periods = periods_s(kept.times_ns, holes)
    constant = [column for column in kept.columns if _is_constant(column, kept.decoded)]
    varying = [column for column in kept.columns if not _is_constant(column, kept.decoded)]
    notes = [
        capture.odd_times,
        kept.skipped,
        kept.bounds("Jumps and stuck values were searched in", capture.began_ns),
    ]
    if not kept.all_kept:
        until = recorded_time(int(kept.times_ns[-1]), capture.began_ns) if len(kept.times_ns) else "its beginning"
        notes.append(f"Periods and gaps cover the time up to {until}; later times did not fit in memory.")
    if not kept.columns:
        notes.insert(0, "It has no numeric fields; to measure bytes, booleans or stamps, name them in fields.")
    elif len(varying) > most_fields:
        left_out = len(varying) - most_fields
        first = varying[most_fields].path.path
        notes.insert(0, f"{left_out} more fields, from {first} on, are not shown; name them in fields.")
    if kept.replayed:
        notes.insert(
            0,
            f"{FromBefore.of(kept.replayed, kept.replayed_ns, capture.end_ns)}: measured, but not counted in the rate.",
        )
    if not kept.seen:
        notes.insert(0, "No message in this time." if capture.publishers else "The topic had no publisher.")
    elif capture.dropped:
        notes.insert(0, f"{capture.dropped} older messages did not fit in memory and are not counted.")
    rate = kept.rate_hz(holes)
    if rate and is_burst(kept.count, rate, capture.duration_s):
        notes.insert(0, burst_in_words(kept.count, rate))
        rate = None
    return TopicStatistics(
        capture.topic,
        capture.type,
        count=kept.seen,
        rate_hz=four_digits(rate),
        period_median_s=microseconds(float(np.median(periods)) if len(periods) else None),
        period_std_s=microseconds(float(periods.std()) if len(periods) > 1 else None),
        gaps=_gap_lines(capture),
        fields=[_field_statistics(column, capture) for column in varying[:most_fields]],
        constants={column.path.path: _constant(column) for column in constant},
        started_at=iso_time(capture.start_ns),
        seconds_from_start=seconds_from_start(capture.start_ns, capture.began_ns),
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
        f"nothing for {gap.duration_s:.3f} s from {both_times(gap.from_ns, capture.zero_ns)} on"
        f"{': the recording is damaged there' if gap.in_hole else ''}"
        for gap in shown
    ]
    return lines + ([f"{len(found) - len(shown)} shorter gaps"] if len(found) > len(shown) else [])


def _field_statistics(column: Column, capture: Capture[Columns]) -> FieldStatistics:
    """Return the statistics of one field; for a list, the elements of all messages count together."""
    from ros2_mcp.ops.measure.signals import number

    totals, path = column.totals, column.path
    anomalies: list[str] = []
    if totals.not_finite:
        kinds = ((totals.nan, "NaN"), (totals.not_finite - totals.nan, "infinite"))
        counted = ", ".join(f"{count} {kind}" for count, kind in kinds if count)
        anomalies.append(f"{totals.not_finite} of {totals.total} values are not finite: {counted}")
    if not totals.count:
        return FieldStatistics(path.path, path.is_list, 0, not_finite=totals.not_finite, anomalies=anomalies)
    trend, found = ("", []) if path.is_list else _trend_and_anomalies(column, capture)
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
        min_at=_extreme_at(column.lowest, path, capture),
        max_at=_extreme_at(column.highest, path, capture),
        trend=trend,
        not_finite=totals.not_finite,
        anomalies=[*anomalies, *found],
    )


def _is_constant(column: Column, messages: int) -> bool:
    """Return whether the field has the same finite value in every message. Fields that only some messages have are not
    constant, so that their count is shown.
    """
    return column.messages == messages > 1 and column.is_constant and not column.totals.not_finite


def _constant(column: Column) -> float | str:
    """Return the constant value; for a list with different elements, their number and range in words."""
    totals = column.totals
    value = column.first_value
    if value.dtype.kind in "iu" and (value == value[0]).all():
        return float(value[0]) if abs(int(value[0])) <= _EXACT else str(value[0])
    if totals.min == totals.max and value.dtype.kind == "f":
        return totals.min
    return f"{len(column.first_value)} values, {totals.min:g} to {totals.max:g}"


def _short(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:g}"


def _listed(what: str, entries: Sequence[str]) -> str:
    more = f" and {len(entries) - _MAX_NAMED} more" if len(entries) > _MAX_NAMED else ""
    return f"{what}: {', '.join(entries[:_MAX_NAMED])}{more}" if entries else ""


def _extreme_at(extreme: Extreme, path: FieldPath, capture: Capture[Columns]) -> str:
    at = both_times((capture.kept.origin_ns or 0) + round(extreme.at_s * 1e9), capture.zero_ns)
    element = path.element(extreme.element) if path.is_list else None
    return at if element is None else f"element {element}, {at}"


def _trend_and_anomalies(column: Column, capture: Capture[Columns]) -> tuple[str, list[str]]:
    """Return the trend and the anomalies (jumps, stuck value) in words; changes across a hole are no jumps."""
    import numpy as np

    from ros2_mcp.ops.measure import signals
    from ros2_mcp.ops.measure.columns import seconds

    values = column.values
    finite = np.isfinite(values)
    times, values = seconds(capture.kept.read_ns[column.rows], capture.start_ns)[finite], values[finite]
    holes = [((begin - capture.start_ns) / 1e9, (end - capture.start_ns) / 1e9) for begin, end in capture.holes]

    def is_over_hole(since_s: float, until_s: float) -> bool:
        return any(since_s < end_s and until_s > begin_s for begin_s, end_s in holes)

    with np.errstate(over="ignore", invalid="ignore"):  # values near the limits of float64
        rounded = signals.rounding(column.path)
        jumps, still = signals.jumps(times, values, rounded), signals.stuck(times, values)
        slope = signals.trend(times, values, rounded)
    trend = ""
    if slope is not None:
        over_s = float(times[-1] - times[0])
        way = "rises" if slope > 0 else "falls"
        trend = f"{way} steadily by {abs(slope):.3g}/s ({slope * over_s:+.3g} in {over_s:.3g} s)"
    found = [jump for jump in jumps if not is_over_hole(jump.since_s, jump.at_s)]

    def when(at_s: float) -> str:
        return both_times(capture.start_ns + round(at_s * 1e9), capture.zero_ns)

    lines = [f"jump from {jump.before:g} to {jump.after:g} at {when(jump.at_s)}" for jump in found]
    if len(found) > _MAX_LISTED:  # list the first ones and the last one, which ends a burst
        between = f"{len(found) - _MAX_LISTED} more jumps, up to the last one:"
        lines = [*lines[: _MAX_LISTED - 1], between, lines[-1]]
    if still:
        lines.append(f"stuck at {still.value:g} for {still.duration_s:.3f} s from {when(still.at_s)} on")
        if is_over_hole(still.at_s, still.at_s + still.duration_s):
            lines[-1] += " (a part of that time is damaged and cannot be read)"
    return trend, lines
