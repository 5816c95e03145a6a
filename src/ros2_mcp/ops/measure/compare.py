"""Comparing two topics over the same time, live or recorded."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Literal

from ros2_mcp.guard.policy import bounded
from ros2_mcp.model.errors import BadInput, BadValue
from ros2_mcp.ops.measure.statistics import seconds
from ros2_mcp.ops.results import Report, silent
from ros2_mcp.ops.sources.source import Capture, Missing, Source

if TYPE_CHECKING:
    from ros2_mcp.codec.select import FieldPath
    from ros2_mcp.ops.measure.signals import Numbers

SIMILAR_PERCENT = 5.0
DIFFERENT_PERCENT = 50.0
_UNPAIRED_SHARE = 0.1
_UNPAIRED = 2
_REASONS = 5
_SURE = 0.7

Verdict = Literal["IDENTICAL", "SIMILAR", "DIFFERENT", "VERY DIFFERENT"]


@dataclass(frozen=True, slots=True)
class FieldComparison:
    """One field in both topics, over the paired messages; differences are second minus first.

    `scale` is the largest magnitude that either topic has; the percentages are of it. `correlation` is Pearson's, null
    where one does not vary. `delay_s` is by how much the second follows the first (by cross-correlation of the
    values over the time of receipt), null where the two do not resemble each other. `not_compared` counts values that
    are NaN or infinite in only one of them, or are missing.
    """

    field: str
    compared: int
    mean_difference: float | None = None
    max_difference: float | None = None
    rms_difference: float | None = None
    max_percent: float | None = None
    rms_percent: float | None = None
    scale: float | None = None
    correlation: float | None = None
    delay_s: float | None = None
    not_compared: int = 0


@dataclass(frozen=True, slots=True)
class Comparison:
    """How two topics differ.

    `IDENTICAL`: every field agrees within the tolerance, and every message has its partner (but for the edges).
    `SIMILAR`: the root of the mean squared difference is at most 5 % of the field's scale in every field;
    `DIFFERENT`: at most 50 %; `VERY DIFFERENT`: more, or nothing to compare. `receive_delay_s` is by how much the
    second topic's message of a pair is received later, in the mean.
    """

    topic1: str
    topic2: str
    verdict: Verdict
    reasons: Sequence[str]
    tolerance_percent: float
    paired_by: str
    count1: int
    count2: int
    pairs: int
    equal_messages: int
    receive_delay_s: float | None
    delay_s: float | None
    fields: Sequence[FieldComparison]
    source: str

    def summary(self) -> str:
        """The verdict with its reasons."""
        return f"{self.topic1} and {self.topic2}: {self.verdict}. {' '.join(self.reasons)}"


async def compare(
    source: Source,
    topics: tuple[str, str],
    fields: Sequence[str] = (),
    *,
    tolerance_percent: float = 0.1,
    by_stamp: bool = True,
    report: Report = silent,
) -> Comparison:
    """Compares the chosen fields of two topics, or all numeric ones that both have.

    Raises:
        BadInput: if both topics are the same one, or their types have no field in common.
        BadValue: for a field that one of them does not have, or a number out of range.
        NotFound: if a topic is not there.
    """
    bounded("tolerance_percent", tolerance_percent, 0.0, 100.0, "%")
    if topics[0].strip("/") == topics[1].strip("/"):
        raise BadInput(f"{topics[0]} is given twice.", "Give two topics.")
    types = [await source.type_of(topic) for topic in topics]
    common_fields(source, types, fields)
    first, second = await source.captures(topics, report)
    for capture in (first, second):
        if isinstance(capture, Missing):
            raise capture.error
    assert isinstance(first, Capture)
    assert isinstance(second, Capture)
    return await asyncio.to_thread(
        evaluate, first, second, fields, tolerance_percent=tolerance_percent, by_stamp=by_stamp
    )


def common_fields(
    source: Source | Capture, types: Sequence[str], fields: Sequence[str]
) -> list[tuple[FieldPath, FieldPath]]:
    """What is compared: the chosen fields, or all numeric ones that both types have.

    Raises:
        BadInput: if there is none.
        BadValue: if a chosen one is not in both.
    """
    from ros2_mcp.codec.select import measurable

    first, second = (
        {each.path: each for each in measurable(source.codec.definitions, type_name, fields)} for type_name in types
    )
    common = [(first[path], second[path]) for path in first if path in second]
    if not common:
        raise BadInput(f"{types[0]} and {types[1]} have no numeric field in common.", "Compare topics of one type.")
    return common


def evaluate(
    first: Capture,
    second: Capture,
    fields: Sequence[str] = (),
    *,
    tolerance_percent: float = 0.1,
    by_stamp: bool = True,
) -> Comparison:
    """Compares two captures; raises as `compare`, and `BadData` if no message of one is what its type says."""
    from ros2_mcp.ops.measure import signals

    readings = common_fields(first, (first.type, second.type), fields)
    first, first_messages, first_trouble = first.readable()
    second, second_messages, second_trouble = second.readable()
    messages = [first_messages, second_messages]
    times, paired_by = _times(first, second, by_stamp)
    partners = signals.pairs(*times)
    compared = [_compare_field(pair, messages, (seconds(first), seconds(second)), partners) for pair in readings]
    received = [
        (second.samples[j].received_ns - first.samples[i].received_ns) / 1e9 for i, j in partners
    ]  # fmt: skip
    verdict, reasons = _judge(first, second, len(partners), compared, tolerance_percent)
    reasons += [
        f"{topic}: {said}" for topic, said in ((first.topic, first_trouble), (second.topic, second_trouble)) if said
    ]
    return Comparison(
        first.topic,
        second.topic,
        verdict,
        reasons,
        tolerance_percent,
        paired_by,
        len(first.samples),
        len(second.samples),
        len(partners),
        sum(first.samples[i].data == second.samples[j].data for i, j in partners),
        sum(received) / len(received) if received else None,
        _likely_delay(compared),
        compared,
        first.source,
    )


def _times(first: Capture, second: Capture, by_stamp: bool) -> tuple[tuple[Numbers, Numbers], str]:
    """The times by which messages are paired, in seconds, and what they are."""
    from ros2_mcp.ops.measure.signals import flat

    by_receipt = (seconds(first), seconds(second))
    if not by_stamp:
        return by_receipt, "nearest time of receipt"
    stamps = first.stamps_ns(), second.stamps_ns()
    if stamps[0] is None or stamps[1] is None:
        return by_receipt, "nearest time of receipt: not both have a header"
    if not stamps[0] or not stamps[1]:
        return by_receipt, "nearest time of receipt: a topic is silent"
    if not all(_rises(each) for each in stamps if each is not None):
        return by_receipt, "nearest time of receipt: the stamps do not rise"
    if stamps[0][-1] < stamps[1][0] or stamps[1][-1] < stamps[0][0]:
        return by_receipt, "nearest time of receipt: the stamps are of different times"
    origin = stamps[0][0]
    return (flat([(at - origin) / 1e9 for at in stamps[0]]), flat([(at - origin) / 1e9 for at in stamps[1]])), "stamp"


def _rises(stamps: Sequence[int]) -> bool:
    return stamps[-1] > 0 and all(later > earlier for earlier, later in pairwise(stamps))


def _compare_field(
    readings: tuple[FieldPath, FieldPath],
    messages: Sequence[Sequence[object]],
    times: tuple[Numbers, Numbers],
    partners: Sequence[tuple[int, int]],
) -> FieldComparison:
    import numpy as np

    from ros2_mcp.ops.measure import signals

    values = [[_value(reading, message) for message in each] for reading, each in zip(readings, messages, strict=True)]
    same_length = [(values[0][i], values[1][j]) for i, j in partners if len(values[0][i]) == len(values[1][j])]
    one = np.concatenate([pair[0] for pair in same_length]) if same_length else signals.flat([])
    other = np.concatenate([pair[1] for pair in same_length]) if same_length else signals.flat([])
    both, alike = np.isfinite(one) & np.isfinite(other), (one == other) | (np.isnan(one) & np.isnan(other))
    not_compared = int(np.count_nonzero(~both & ~alike)) + len(partners) - len(same_length)
    one, other = one[both], other[both]
    if not len(one):
        return FieldComparison(readings[0].path, 0, not_compared=not_compared)
    with np.errstate(over="ignore", invalid="ignore"):
        difference = other - one
        scale = float(max(np.abs(one).max(), np.abs(other).max()))
        shares = difference / (scale or 1.0)
        largest, rms = float(np.abs(difference).max()), float(np.sqrt(np.mean(shares**2))) * (scale or 1.0)
        return FieldComparison(
            readings[0].path,
            len(one),
            signals.number(difference.mean()),
            signals.number(largest),
            signals.number(rms),
            signals.number(100 * largest / scale) if scale else 0.0,
            signals.number(100 * rms / scale) if scale else 0.0,
            signals.number(scale),
            signals.correlation(one, other),
            None if readings[0].is_list else _delay(times, values),
            not_compared,
        )


def _value(reading: FieldPath, message: object) -> Numbers:
    from ros2_mcp.ops.measure.signals import flat

    try:
        return flat(reading.value_in(message))
    except BadValue:
        return flat([])


def _delay(times: tuple[Numbers, Numbers], values: Sequence[Sequence[Numbers]]) -> float | None:
    import numpy as np

    from ros2_mcp.ops.measure import signals

    series: list[tuple[Numbers, Numbers]] = []
    for when, each in zip(times, values, strict=True):
        there = np.array([len(value) == 1 and bool(np.isfinite(value[0])) for value in each], bool)
        series.append(
            (when[there], signals.flat([value[0] for value, is_there in zip(each, there, strict=True) if is_there]))
        )
    found, score = signals.delay(*series[0], *series[1])
    return found if score is not None and score >= _SURE else None


def _likely_delay(compared: Sequence[FieldComparison]) -> float | None:
    """The middle one of the fields' delays."""
    delays = sorted(each.delay_s for each in compared if each.delay_s is not None)
    return delays[len(delays) // 2] if delays else None


def _judge(
    first: Capture, second: Capture, pairs: int, compared: Sequence[FieldComparison], tolerance: float
) -> tuple[Verdict, list[str]]:
    if not pairs:
        silent_ones = [capture.topic for capture in (first, second) if not capture.samples]
        why = f"{' and '.join(silent_ones)} sent nothing." if silent_ones else "No two messages are near in time."
        return "VERY DIFFERENT", [why]
    reasons = _differences(compared, tolerance)
    alone = max(len(first.samples), len(second.samples)) - pairs
    unpaired = alone > max(_UNPAIRED, _UNPAIRED_SHARE * max(len(first.samples), len(second.samples)))
    if unpaired:
        reasons.append(f"{alone} messages have no partner ({len(first.samples)} and {len(second.samples)} came).")
    odd = sum(each.not_compared for each in compared)
    if odd:
        reasons.append(f"{odd} values are not finite or missing in one of them only.")
    if not reasons:
        return "IDENTICAL", [f"All {len(compared)} fields of {pairs} pairs agree within {tolerance:g} %."]
    worst = max((_percent(each) for each in compared if each.compared), default=0.0)
    if worst <= max(SIMILAR_PERCENT, tolerance):
        return "SIMILAR", reasons
    return ("DIFFERENT" if worst <= max(DIFFERENT_PERCENT, tolerance) else "VERY DIFFERENT"), reasons


def _percent(field: FieldComparison) -> float:
    """How much it differs; a difference beyond all numbers is infinite."""
    return math.inf if field.rms_percent is None else field.rms_percent


def _differences(compared: Sequence[FieldComparison], tolerance: float) -> list[str]:
    beyond = [each for each in compared if each.max_percent is None or each.max_percent > tolerance]
    beyond.sort(key=_percent, reverse=True)
    lines = [
        f"{each.field} differs by {each.rms_difference or 0.0:.3g} ({each.rms_percent or 0.0:.3g} %) RMS, "
        f"{each.max_difference or 0.0:.3g} at most."
        for each in beyond[:_REASONS]
        if each.compared
    ]
    return lines + ([f"{len(beyond) - _REASONS} more fields differ."] if len(beyond) > _REASONS else [])
