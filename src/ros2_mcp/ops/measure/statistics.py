"""Statistics of numeric fields over a capture, live or recorded."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ros2_mcp.model.errors import BadInput, BadValue, RobotError
from ros2_mcp.model.text import named
from ros2_mcp.ops.measure.flow import gaps, rate_hz
from ros2_mcp.ops.results import Report, iso_time, silent
from ros2_mcp.ops.sources.selection import Selection
from ros2_mcp.ops.sources.source import Capture, Missing, Source

if TYPE_CHECKING:
    from ros2_mcp.codec.select import FieldPath
    from ros2_mcp.ops.measure.signals import Numbers

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
    captures = await source.captures(topics, report)
    most_fields = max((selection.max_bytes // len(topics) - _TOPIC_BYTES) // _FIELD_BYTES, _MIN_FIELDS)

    def evaluated(capture: Capture | Missing) -> TopicStatistics:
        if isinstance(capture, Missing):
            return TopicStatistics(capture.topic, error=str(capture.error))
        try:
            return evaluate(capture, selection.fields, most_fields)
        except RobotError as error:
            return TopicStatistics(capture.topic, capture.type, count=len(capture.samples), error=str(error))

    return Statistics(source.words, await asyncio.to_thread(lambda: list(map(evaluated, captures))))


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


def evaluate(capture: Capture, fields: Sequence[str] = (), most_fields: int = 80) -> TopicStatistics:
    """The statistics of one capture; a chosen field that this type does not have is left out.

    Raises:
        BadData: if no message is what the type says.
    """
    import numpy as np

    from ros2_mcp.codec.select import measurable
    from ros2_mcp.ops.measure.series import seconds

    found = [] if fields else measurable(capture.definitions, capture.type)
    for path in fields:
        with suppress(BadValue):  # another of the topics has it
            found += measurable(capture.definitions, capture.type, [path])
    readable, messages, trouble = capture.readable() if found else (capture, [], "")
    times = seconds(capture)
    periods = np.diff(times)
    notes = [trouble]
    if not found:
        notes.insert(0, "It has no numbers to measure; choose fields for bytes, booleans and stamps.")
    elif len(found) > most_fields:
        left_out = len(found) - most_fields
        notes.insert(0, f"{left_out} more fields are not shown: choose fields, from {found[most_fields].path} on.")
    if not capture.samples:
        notes.insert(0, "Silent in this time." if capture.publishers else "Nobody published on it.")
    elif capture.dropped:
        notes.insert(0, f"{capture.dropped} messages were too much to keep; the newest are counted.")
    return TopicStatistics(
        capture.topic,
        capture.type,
        count=len(times),
        rate_hz=rate_hz(times.tolist()),
        period_median_s=float(np.median(periods)) if len(periods) else None,
        period_std_s=float(periods.std()) if len(periods) > 1 else None,
        gaps=_gap_lines(times.tolist(), capture.duration_s),
        fields=[_field_statistics(field, messages, seconds(readable)) for field in found[:most_fields]],
        started_at=iso_time(capture.start_ns),
        duration=capture.duration_s,
        received=capture.received,
        dropped=capture.dropped,
        lost=capture.lost,
        publishers=capture.publishers,
        note=" ".join(filter(None, notes)),
    )


def _gap_lines(times_s: Sequence[float], duration_s: float) -> list[str]:
    found = sorted(gaps(times_s, 0.0, duration_s), key=lambda gap: -gap.duration_s)
    shown = sorted(found[: 2 * _MAX_LISTED], key=lambda gap: gap.at_s)
    lines = [f"nothing for {gap.duration_s:.3f} s from {gap.at_s:.3f} s on" for gap in shown]
    return lines + ([f"{len(found) - len(shown)} shorter gaps"] if len(found) > len(shown) else [])


def _field_statistics(field: FieldPath, messages: Sequence[object], times: Numbers) -> FieldStatistics:
    """The statistics of one field over messages that were received at `times`.

    `numbers` are all its values, of a list all elements of all messages. `series` has one finite value at each time
    `when`: the value itself, of a list the mean of its finite elements.
    """
    import numpy as np

    from ros2_mcp.ops.measure import signals
    from ros2_mcp.ops.measure.series import present

    when, values = present(field, messages, times)
    with np.errstate(over="ignore", invalid="ignore"):  # numbers at the end of their range; a result of inf is null
        if field.is_list:
            arrays = [signals.flat(value) for value in values]
            numbers = np.concatenate(arrays) if arrays else signals.flat([])
            finite_parts = [array[np.isfinite(array)] for array in arrays]
            when = when[[len(part) > 0 for part in finite_parts]]
            series = signals.flat([part.mean() for part in finite_parts if len(part)])
            constant = len(arrays) > 1 and all(np.array_equal(array, arrays[0], equal_nan=True) for array in arrays)
        else:
            numbers = signals.flat(values)
            when, series = when[np.isfinite(numbers)], numbers[np.isfinite(numbers)]
            constant = len(numbers) > 1 and bool((numbers == numbers[0]).all())
        finite = numbers[np.isfinite(numbers)]
        not_finite, nan = len(numbers) - len(finite), int(np.count_nonzero(np.isnan(numbers)))
        anomalies = [f"{not_finite} of {len(numbers)} values are not finite ({nan} NaN)"] if not_finite else []
        if not len(finite):
            return FieldStatistics(field.path, field.is_list, 0, not_finite=not_finite, anomalies=anomalies)
        return FieldStatistics(
            field.path,
            field.is_list,
            count=len(finite),
            min=signals.number(finite.min()),
            max=signals.number(finite.max()),
            mean=signals.number(finite.mean()),
            std=signals.number(finite.std()),
            first=signals.number(series[0]),
            last=signals.number(series[-1]),
            slope=signals.slope(when, series),
            constant=constant,
            not_finite=not_finite,
            anomalies=[] if field.is_list else [*anomalies, *_anomalies(when, series)],
        )


def _anomalies(times: Numbers, values: Numbers) -> list[str]:
    """Jumps and the time that the value stood still, in words."""
    from ros2_mcp.ops.measure import signals

    found = signals.jumps(times, values)
    lines = [f"jump from {jump.before:g} to {jump.after:g} at {jump.at_s:.3f} s" for jump in found[:_MAX_LISTED]]
    if len(found) > _MAX_LISTED:
        lines.append(f"{len(found) - _MAX_LISTED} more jumps")
    if still := signals.stuck(times, values):
        lines.append(f"stuck at {still.value:g} for {still.duration_s:.3f} s from {still.at_s:.3f} s on")
    return lines
