"""Statistics of numeric fields over a capture, live or recorded."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ros2_mcp.model.errors import BadInput, BadValue, RobotError
from ros2_mcp.ops.measure.flow import gaps, rate_hz
from ros2_mcp.ops.results import Report, iso_time, silent
from ros2_mcp.ops.sources.selection import Selection
from ros2_mcp.ops.sources.source import Capture, Missing, Source

if TYPE_CHECKING:
    from ros2_mcp.codec.select import FieldPath
    from ros2_mcp.ops.measure.signals import Numbers

MAX_TOPICS = 20
MAX_DURATION_S = 600.0
_FIELD_BYTES = 350
_TOPIC_BYTES = 500
_LISTED = 5


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

    def summary(self) -> str:
        """One line, and one for each gap and anomaly."""
        if self.error:
            return f"{self.topic_name}: {self.error}"
        rate = "rate unknown" if self.rate_hz is None else f"{self.rate_hz:.2f} Hz"
        line = f"{self.topic_name}: {self.count} message(s), {rate}, {len(self.fields)} field(s). {self.note}".rstrip()
        odd = [f"{each.field}: {anomaly}" for each in self.fields for anomaly in each.anomalies]
        return "\n  ".join([line, *self.gaps, *odd])


@dataclass(frozen=True, slots=True)
class Statistics:
    """Several topics over the same time; an `error` of one leaves the others."""

    source: str
    topics: Sequence[TopicStatistics]

    def summary(self) -> str:
        """Some lines for each topic."""
        return "\n".join(topic.summary() for topic in self.topics)


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
    check_topics(topics)
    fields = selection.fields
    await _check_fields(source, topics, fields)
    captures = await source.captures(topics, report)
    most = max((selection.max_bytes // len(topics) - _TOPIC_BYTES) // _FIELD_BYTES, 3)
    return Statistics(source.words, await asyncio.to_thread(_evaluate_all, captures, fields, most))


def check_topics(topics: Sequence[str]) -> None:
    """Raises `BadInput` unless there are 1 to 20 different topics."""
    if not 1 <= len(topics) <= MAX_TOPICS:
        raise BadInput(f"{len(topics)} topics are given.", f"Give 1 to {MAX_TOPICS}.")
    twice = sorted({topic for topic in topics if list(topics).count(topic) > 1})
    if twice:
        raise BadInput(f"{', '.join(twice)} is given twice.", "Give each topic once.")


async def _check_fields(source: Source, topics: Sequence[str], fields: Sequence[str]) -> None:
    """Raises the error of a field that no topic has, before any time is spent on measuring."""
    from ros2_mcp.codec.select import measurable

    types: list[str] = []
    for topic in topics if fields else ():
        try:
            types.append(await source.type_of(topic))
        except RobotError:
            continue
    for field in fields if types else ():
        errors: list[BadValue] = []
        for type_name in types:
            try:
                measurable(source.codec.definitions, type_name, [field])
            except BadValue as error:
                errors.append(error)
        if len(errors) == len(types):
            raise errors[0]


def _evaluate_all(captures: Sequence[Capture | Missing], fields: Sequence[str], most: int) -> list[TopicStatistics]:
    return [_evaluate_or_error(capture, fields, most) for capture in captures]


def _evaluate_or_error(capture: Capture | Missing, fields: Sequence[str], most: int) -> TopicStatistics:
    if isinstance(capture, Missing):
        return TopicStatistics(capture.topic, error=str(capture.error))
    try:
        return evaluate(capture, fields, most)
    except RobotError as error:
        return TopicStatistics(capture.topic, capture.type, count=len(capture.samples), error=str(error))


def evaluate(capture: Capture, fields: Sequence[str] = (), most_fields: int = 80) -> TopicStatistics:
    """The statistics of one capture; a chosen field that this type does not have is left out.

    Raises:
        BadData: if no message is what the type says.
    """
    import numpy as np

    readings, note = _readings(capture, fields, most_fields)
    readable, messages, trouble = capture.readable() if readings else (capture, [], "")
    times = seconds(capture)
    periods = np.diff(times)
    return TopicStatistics(
        capture.topic,
        capture.type,
        count=len(times),
        rate_hz=rate_hz(times.tolist()),
        period_median_s=float(np.median(periods)) if len(periods) else None,
        period_std_s=float(periods.std()) if len(periods) > 1 else None,
        gaps=_gap_lines(capture, times),
        fields=[_field(each, messages, seconds(readable)) for each in readings],
        started_at=iso_time(capture.start_ns),
        duration=capture.duration_s,
        received=capture.received,
        dropped=capture.dropped,
        lost=capture.lost,
        publishers=capture.publishers,
        note=" ".join(filter(None, (_note(capture), note, trouble))),
    )


def seconds(capture: Capture) -> Numbers:
    """When each sample was received, in seconds from the capture's beginning."""
    from ros2_mcp.ops.measure.signals import flat

    return flat([(sample.received_ns - capture.start_ns) / 1e9 for sample in capture.samples])


def _readings(capture: Capture, fields: Sequence[str], most: int) -> tuple[list[FieldPath], str]:
    from ros2_mcp.codec.select import measurable

    found: list[FieldPath] = []
    for chosen in fields:
        try:
            found += measurable(capture.definitions, capture.type, [chosen])
        except BadValue:
            continue
    if not fields:
        found = measurable(capture.definitions, capture.type)
    if len(found) <= most:
        return found, "" if found else "It has no numbers to measure; choose fields for bytes, booleans and stamps."
    return found[:most], f"{len(found) - most} more fields are not shown: choose fields, from {found[most].path} on."


def _note(capture: Capture) -> str:
    if not capture.samples:
        return "Silent in this time." if capture.publishers else "Nobody published on it."
    return f"{capture.dropped} messages were too much to keep; the newest are counted." if capture.dropped else ""


def _gap_lines(capture: Capture, times: Numbers) -> list[str]:
    found = sorted(gaps(times.tolist(), 0.0, capture.duration_s), key=lambda gap: -gap.duration_s)
    shown = sorted(found[: 2 * _LISTED], key=lambda gap: gap.at_s)
    lines = [f"nothing for {gap.duration_s:.3f} s from {gap.at_s:.3f} s on" for gap in shown]
    return lines + ([f"{len(found) - len(shown)} shorter gaps"] if len(found) > len(shown) else [])


def _field(reading: FieldPath, messages: Sequence[object], times: Numbers) -> FieldStatistics:
    import numpy as np

    from ros2_mcp.ops.measure import signals

    found = zip(times, messages, strict=True)
    present = [(time, value) for time, message in found for value in _values(reading, message)]
    when, values = signals.flat([time for time, _ in present]), [value for _, value in present]
    numbers, when, series, constant = _of_lists(when, values) if reading.is_list else _of_numbers(when, values)
    finite = numbers[np.isfinite(numbers)]
    if not len(finite):
        not_finite = len(numbers)
        return FieldStatistics(reading.path, reading.is_list, 0, not_finite=not_finite, anomalies=_strange(numbers))
    with np.errstate(over="ignore", invalid="ignore"):
        return FieldStatistics(
            reading.path,
            reading.is_list,
            count=len(finite),
            min=signals.number(finite.min()),
            max=signals.number(finite.max()),
            mean=signals.number(finite.mean()),
            std=signals.number(finite.std()),
            first=signals.number(series[0]),
            last=signals.number(series[-1]),
            slope=signals.slope(when, series),
            constant=constant,
            not_finite=len(numbers) - len(finite),
            anomalies=[] if reading.is_list else [*_strange(numbers), *_anomalies(when, series)],
        )


def _of_numbers(times: Numbers, values: Sequence[Any]) -> tuple[Numbers, Numbers, Numbers, bool]:
    """All numbers; the finite ones over time; whether all are the same."""
    import numpy as np

    from ros2_mcp.ops.measure.signals import flat

    numbers = flat(values)
    there = np.isfinite(numbers)
    constant = len(numbers) > 1 and bool((numbers == numbers[0]).all())
    return numbers, times[there], numbers[there], constant


def _of_lists(times: Numbers, values: Sequence[Any]) -> tuple[Numbers, Numbers, Numbers, bool]:
    """All elements of all lists; the means of the finite ones over time; whether all lists are the same."""
    import numpy as np

    from ros2_mcp.ops.measure.signals import flat

    arrays = [flat(value) for value in values]
    finite = [(time, each[np.isfinite(each)]) for time, each in zip(times, arrays, strict=True)]
    kept = [(time, float(each.mean())) for time, each in finite if len(each)]
    constant = len(arrays) > 1 and all(np.array_equal(each, arrays[0], equal_nan=True) for each in arrays)
    numbers = np.concatenate(arrays) if arrays else flat([])
    return numbers, flat([time for time, _ in kept]), flat([mean for _, mean in kept]), constant


def _values(reading: FieldPath, message: object) -> list[Any]:
    """The value in a message, or nothing where a list has no such element."""
    try:
        value = reading.value_in(message)
    except BadValue:
        return []
    return [value] if not reading.is_list or len(value) else []


def _strange(numbers: Numbers) -> list[str]:
    import numpy as np

    odd = int(np.count_nonzero(~np.isfinite(numbers)))
    nan = int(np.count_nonzero(np.isnan(numbers)))
    return [f"{odd} of {len(numbers)} values are not finite ({nan} NaN)"] if odd else []


def _anomalies(times: Numbers, values: Numbers) -> list[str]:
    from ros2_mcp.ops.measure import signals

    found = signals.jumps(times, values)
    lines = [f"jump from {each.before:g} to {each.after:g} at {each.at_s:.3f} s" for each in found[:_LISTED]]
    if len(found) > _LISTED:
        lines.append(f"{len(found) - _LISTED} more jumps")
    still = signals.stuck(times, values)
    if still:
        lines.append(f"stuck at {still.value:g} for {still.duration_s:.3f} s from {still.at_s:.3f} s on")
    return lines
