"""Comparison of two topics over the same time, live or recorded."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal

from ros2_mcp.guard.policy import bounded
from ros2_mcp.model.errors import BadInput
from ros2_mcp.model.text import counted, listed
from ros2_mcp.ops.results.results import SAID, Report, silent
from ros2_mcp.ops.sources.from_before import FromBefore
from ros2_mcp.ops.sources.source import Capture, Missing, Source, Stream

if TYPE_CHECKING:
    from ros2_mcp.ops.measure.differences import Difference
    from ros2_mcp.ops.measure.paired import Paired
    from ros2_mcp.ops.measure.signals import Numbers
    from ros2_mcp.values.definitions import Definitions
    from ros2_mcp.values.select import FieldPath

# Largest RMS difference, in percent of a field's scale, of topics that are similar, and of those that are different.
SIMILAR_PERCENT = 5.0
DIFFERENT_PERCENT = 50.0
# Messages that may lack a partner in topics that are still identical: one at each end of the time.
_EDGES = 2
# The same for long captures: the share of messages that may lack a partner.
_UNPAIRED_SHARE = 0.1
# The most fields named in the reasons; the table has all.
_MAX_REASONS = 5

Verdict = Literal["IDENTICAL", "SIMILAR", "DIFFERENT", "VERY DIFFERENT"]


@dataclass(frozen=True, slots=True)
class FieldComparison:
    """One field in both topics, over the paired messages; differences are second minus first.

    `compared_as`: a quaternion is one `rotation`, whose difference is the angle between the two; an `angle` (by its
    name: yaw, heading, steering_angle, ...) differs by at most half a turn; all other values are a `number`. `unit` is
    empty if the difference has the unit of the field. Percentages refer to `scale`: the range of values within a topic
    (max - min, the larger of the two; at least a thousandth of the largest magnitude, at most all of it); the magnitude
    if neither topic varies; at least 0.001° for latitude and longitude; half a turn for angles. `correlation` is
    Pearson's, null if one topic does not vary. `delay_s` is the delay of the second topic behind the first (by
    cross-correlation of the values over the time of receipt), null if the two do not correlate. `not_compared` counts
    pairs in which only one of the values is missing, NaN, infinite, or a rotation that was never set (all 0).
    `equal_not_numeric` counts pairs that are identical but cannot be subtracted (NaN, infinity, unset).
    """

    field: str
    compared: int
    compared_as: Literal["number", "angle", "rotation"] = "number"
    unit: str = ""
    mean_difference: float | None = None
    max_difference: float | None = None
    rms_difference: float | None = None
    max_percent: float | None = None
    rms_percent: float | None = None
    scale: float | None = None
    correlation: float | None = None
    delay_s: float | None = None
    not_compared: int = 0
    equal_not_numeric: int = 0


@dataclass(frozen=True, slots=True)
class Comparison:
    """The differences between two topics.

    `IDENTICAL`: every field agrees within the tolerance, and every message has a partner, except at the start and the
    end. `SIMILAR`: in every field, the root mean square (RMS) difference is at most 5 % of the field's scale;
    `DIFFERENT`: at most 50 %; `VERY DIFFERENT`: more, or no pair could be compared. `receive_delay_s`: the second
    message of a pair was received this much later than the first, on average.
    """

    topic1: str = field(metadata=SAID)
    topic2: str = field(metadata=SAID)
    verdict: Verdict = field(metadata=SAID)
    reasons: Sequence[str] = field(metadata=SAID)
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
        """Return the verdict with its reasons."""
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
    """Compare the chosen fields of two topics, or all numeric fields that both have.

    Raises:
        BadInput: if both topics are the same one, or their types have no field in common.
        BadValue: for a field that one of them does not have, or a number out of range.
        NotFound: if a topic is not there.
    """
    bounded("tolerance_percent", tolerance_percent, 0.0, 100.0, "%")
    if await source.name_of(topics[0]) == await source.name_of(topics[1]):
        raise BadInput(f"{topics[0]} is given twice.", "Give two topics.")
    types = [await source.type_of(topic) for topic in topics]
    common_fields(source.codec.definitions, types, fields)  # before any time is spent on listening
    captures: list[Capture[Paired]] = []
    for capture in await source.captures(topics, keeping(types, fields), report):
        if isinstance(capture, Missing):
            raise capture.error
        captures.append(capture)
    found = await asyncio.to_thread(evaluate, *captures, tolerance_percent=tolerance_percent, by_stamp=by_stamp)
    return replace(found, source=_from_before(*captures).beside(found.source)) if source.is_live else found


def keeping(types: Sequence[str], fields: Sequence[str]) -> Callable[[Stream], Paired]:
    """Return the factory for `Source.captures` that keeps the fields common to both types; raises as
    `common_fields`.
    """
    from ros2_mcp.ops.measure.columns import Room
    from ros2_mcp.ops.measure.paired import Paired

    room = Room(times=0)  # the times of the rows are kept

    def keep(stream: Stream) -> Paired:
        side = 0 if stream.type == types[0] else 1
        common = [pair[side] for pair in common_fields(stream.codec.definitions, types, fields)]
        return Paired(stream.codec, stream.type, common, room, whole_lists=True, is_replayed=stream.is_replayed)

    return keep


def common_fields(
    definitions: Definitions, types: Sequence[str], chosen: Sequence[str]
) -> list[tuple[FieldPath, FieldPath]]:
    """Return the pairs of fields to compare: the chosen fields, or all numeric fields that both types have.

    Raises:
        BadInput: if there is none.
        BadValue: if a chosen one is not in both.
    """
    from ros2_mcp.values.select import measurable

    first, second = ({field.path: field for field in measurable(definitions, name, chosen)} for name in types)
    common = [(first[path], second[path]) for path in first if path in second]
    if not common:
        raise BadInput(f"{types[0]} and {types[1]} have no numeric field in common.", "Compare topics of one type.")
    return common


def evaluate(
    first: Capture[Paired], second: Capture[Paired], *, tolerance_percent: float = 0.1, by_stamp: bool = True
) -> Comparison:
    """Compare two captures of the same fields; raises `BadData` if no message of either capture can be decoded."""
    import numpy as np

    from ros2_mcp.ops.measure.differences import differences
    from ros2_mcp.ops.measure.signals import pairs

    for capture in (first, second):
        capture.kept.check()
    times, paired_by = _pairing_times(first, second, by_stamp)
    in_first, in_second = partners = pairs(*times)
    del times
    compared = [_row(one) for one in differences(first, second, partners)]
    delays_ns = second.kept.read_ns[in_second] - first.kept.read_ns[in_first]
    delays_s = sorted(row.delay_s for row in compared if row.delay_s is not None)
    delay_s = delays_s[len(delays_s) // 2] if delays_s else None
    verdict, reasons = _judge(first, second, len(in_first), compared, tolerance_percent)
    if delay_s and abs(delay_s) > max(_period_s(first), _period_s(second)):  # shorter delays may result from noise
        earlier, later = (first, second) if delay_s > 0 else (second, first)
        reasons.append(f"By its values, {later.topic} is {1000 * abs(delay_s):.3g} ms behind {earlier.topic}.")
    for capture in (first, second):
        old = _from_before(capture)
        troubles = (
            f"{old}." if old.count else "",
            capture.mixed,
            capture.kept.skipped,
            capture.kept.bounds("The comparison covers", capture.began_ns),
        )
        reasons += [f"{capture.topic}: {trouble}" for trouble in troubles if trouble]
    return Comparison(
        topic1=first.topic,
        topic2=second.topic,
        verdict=verdict,
        reasons=reasons,
        tolerance_percent=tolerance_percent,
        paired_by=paired_by,
        count1=first.kept.decoded,
        count2=second.kept.decoded,
        pairs=len(in_first),
        equal_messages=int(np.count_nonzero(first.kept.marks[in_first] == second.kept.marks[in_second])),
        receive_delay_s=float(delays_ns.mean()) / 1e9 if len(delays_ns) else None,
        delay_s=delay_s,
        fields=compared,
        source=first.source,
    )


def _from_before(*captures: Capture[Paired]) -> FromBefore:
    """Return which of the messages of these topics were sent before the subscriptions."""
    kept = [capture.kept for capture in captures]
    found = FromBefore.of(sum(one.replayed for one in kept), max(one.replayed_ns for one in kept), captures[0].end_ns)
    return replace(found, all_of=sum(one.seen for one in kept))


def _period_s(capture: Capture[Paired]) -> float:
    """Return the mean period between messages in s; infinite if there are fewer than two."""
    read_ns = capture.kept.read_ns
    return float(read_ns[-1] - read_ns[0]) / 1e9 / (len(read_ns) - 1) if len(read_ns) > 1 else math.inf


def _pairing_times(
    first: Capture[Paired], second: Capture[Paired], by_stamp: bool
) -> tuple[tuple[Numbers, Numbers], str]:
    """Return the times by which messages are paired, in s, and a description of these times."""
    from ros2_mcp.ops.measure.columns import seconds

    stamps = (first.kept.stamps_ns, second.kept.stamps_ns) if by_stamp else (None, None)
    reason = ""
    if stamps[0] is None or stamps[1] is None:
        reason = ": not both topics have a header" if by_stamp else ""
    elif not len(stamps[0]) or not len(stamps[1]):
        reason = ": a topic has no messages"
    elif any(own[-1] <= 0 or (own[1:] <= own[:-1]).any() for own in (stamps[0], stamps[1])):
        reason = ": the stamps do not increase"
    elif stamps[0][-1] < stamps[1][0] or stamps[1][-1] < stamps[0][0]:
        reason = ": the stamps do not overlap in time"
    else:
        # Times count from the first stamp, because a Unix time in nanoseconds does not fit a float exactly.
        origin = int(stamps[0][0])
        return (seconds(stamps[0], origin), seconds(stamps[1], origin)), "stamp"
    sides = (first, second)
    first_s, second_s = (seconds(capture.kept.read_ns, capture.start_ns) for capture in sides)
    return (first_s, second_s), f"nearest time of receipt{reason}"


def _row(difference: Difference) -> FieldComparison:
    """Return the result row of one field's differences."""
    import numpy as np

    from ros2_mcp.ops.measure.signals import number

    values = difference.values
    row = FieldComparison(
        difference.field,
        len(values),
        compared_as=difference.kind,
        unit=difference.unit,
        not_compared=difference.not_compared,
        equal_not_numeric=difference.equal_not_numeric,
    )
    if not len(values):
        return row
    # The difference of values at the ends of their range may be infinite, which is shown as null. The squares of shares
    # of the scale do not overflow, unlike squares of the differences.
    with np.errstate(over="ignore", invalid="ignore"):
        unit = difference.scale or 1.0
        largest, rms = float(np.abs(values).max()), float(np.sqrt(np.mean((values / unit) ** 2))) * unit
        return replace(
            row,
            mean_difference=number(values.mean()),
            max_difference=number(largest),
            rms_difference=number(rms),
            max_percent=number(100 * largest / unit),
            rms_percent=number(100 * rms / unit),
            scale=number(difference.scale),
            correlation=difference.correlation,
            # A field that is equal in every pair has no delay, whatever correlation yields for few values.
            delay_s=difference.delay_s and (difference.delay_s if largest else 0.0),
        )


def _in_holes(capture: Capture[Paired], partner: Capture[Paired]) -> int:
    """Return the number of messages without a partner because they lie in a hole of the other topic's recording."""
    times_ns = capture.kept.read_ns
    return sum(int(((times_ns >= begin) & (times_ns <= end)).sum()) for begin, end in partner.holes)


def _judge(
    first: Capture[Paired], second: Capture[Paired], pairs: int, compared: Sequence[FieldComparison], tolerance: float
) -> tuple[Verdict, list[str]]:
    """Return the verdict as defined in `Comparison`, and its reasons, the largest differences first."""
    counts = first.kept.rows, second.kept.rows
    if not pairs:
        without = [capture for capture in (first, second) if not capture.kept.rows]
        lost = " and ".join(capture.topic for capture in without if capture.holes)
        silent_topics = " and ".join(capture.topic for capture in without if not capture.holes)
        damaged = f"Nothing was compared: the recording is damaged, and no message of {lost} can be read."
        reasons = [damaged] if lost else []
        reasons += [f"No message was received on {silent_topics}."] if silent_topics else []
        return "VERY DIFFERENT", reasons or ["No two messages are close in time."]

    def percent(row: FieldComparison) -> float:
        return math.inf if row.rms_percent is None else row.rms_percent  # null: too large for a float

    one_sided = [row.field for row in compared if not row.compared and row.not_compared]
    absent = [row.field for row in compared if not (row.compared or row.not_compared or row.equal_not_numeric)]
    differing = [row for row in compared if row.compared and (row.max_percent is None or row.max_percent > tolerance)]
    differing.sort(key=percent, reverse=True)
    reasons = [
        f"{row.field} differs by {row.rms_difference or 0.0:.3g} {row.unit}".rstrip()
        + f" ({row.rms_percent or 0.0:.3g} %) RMS, "
        f"at most {row.max_difference or 0.0:.3g}."
        for row in differing[:_MAX_REASONS]
    ]
    if len(differing) > _MAX_REASONS:
        reasons.append(f"{counted(len(differing) - _MAX_REASONS, 'more field')} differ.")
    unpaired = max(counts) - pairs - max(_in_holes(first, second), _in_holes(second, first))
    if unpaired > max(_EDGES, _UNPAIRED_SHARE * max(counts)):
        reasons.append(f"{counted(unpaired, 'message')} have no partner ({counts[0]} and {counts[1]} received).")
    if not_compared := sum(row.not_compared for row in compared if row.compared_as != "rotation"):
        reasons.append(f"{counted(not_compared, 'value')} are missing or not finite on one topic only.")
    if not_compared := sum(row.not_compared for row in compared if row.compared_as == "rotation"):
        reasons.append(f"{counted(not_compared, 'rotation')} are missing or never set on one topic only.")
    nothing = [f"No value on either topic: {listed(absent, _MAX_REASONS)}."] if absent else []
    if len(absent) == len(compared):
        return "VERY DIFFERENT", reasons + nothing
    if not reasons:
        return "IDENTICAL", [_agreement(compared, len(compared) - len(absent), pairs, tolerance), *nothing]
    reasons += nothing
    worst = max((percent(row) for row in compared if row.compared), default=0.0)
    if len(one_sided) + len(absent) == len(compared):
        return "VERY DIFFERENT", reasons
    if worst <= max(SIMILAR_PERCENT, tolerance) and not one_sided:
        return "SIMILAR", reasons
    return ("DIFFERENT" if worst <= max(DIFFERENT_PERCENT, tolerance) else "VERY DIFFERENT"), reasons


def _agreement(compared: Sequence[FieldComparison], fields: int, pairs: int, tolerance: float) -> str:
    """Return a sentence that the topics agree, with the largest difference."""
    text = f"All {fields} fields of {pairs} pairs agree within {tolerance:g} %"
    most = max(compared, key=lambda row: row.max_percent or 0.0)
    if not most.max_percent:
        return f"{text}."
    return f"{text}; the largest difference is in {most.field}: {most.max_difference:.3g} {most.unit}".rstrip() + "."
