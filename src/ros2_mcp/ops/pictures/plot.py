"""Plots of numeric fields over time, or against each other, as a picture with statistics."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from ros2_mcp.guard.policy import bounded
from ros2_mcp.model.errors import BadInput, BadName, NotFound
from ros2_mcp.model.pictures import MAX_SIDE
from ros2_mcp.model.text import counted
from ros2_mcp.model.times import seconds_from_start
from ros2_mcp.ops.results.results import IF_ANY, SAID, Report, WithPictures, facts, iso_time, silent
from ros2_mcp.ops.sources.from_before import FromBefore
from ros2_mcp.ops.sources.source import Capture, Missing, Source, Stream

if TYPE_CHECKING:
    from ros2_mcp.ops.measure.columns import Columns
    from ros2_mcp.ops.pictures.curves import FieldValues

_PANEL_PIXELS = 140
"""Least height of a panel, in pixels, at which the curve and the labels of its axis are readable."""
_XY_FIELDS = 2
"""The most fields of a message in an x-y plot: x and y."""
_LISTED = 8
"""The most series named that are not shown; a message may have hundreds."""


@dataclass(frozen=True, slots=True)
class PlotRequest:
    """A request: series over time (`time`), or in pairs against each other (`xy`); width and height in pixels.

    A series is a topic and a field, `/odom:twist.twist.linear.x`; a topic alone, or a field that is a message, means
    all its numbers.
    """

    series: Sequence[str]
    kind: str = "time"
    width: int = 1000
    height: int = 640


@dataclass(frozen=True, slots=True)
class Series:
    """One numeric field over the measured time; statistics of its finite values, null if there are none.

    `unit` is empty if not known. `gaps` counts the times without messages, at which the curve is interrupted.
    """

    name: str
    unit: str
    count: int
    min: float | None
    max: float | None
    mean: float | None
    first: float | None
    last: float | None
    not_finite: int
    gaps: int


@dataclass(frozen=True, slots=True)
class Plot(WithPictures):
    """The plotted series. Times are receive times; `note` lists what is not shown, and why.

    `seconds_from_start` is `started_at` as an offset from the start of a recording.
    """

    source: str = field(metadata=SAID)
    kind: str
    started_at: str
    seconds_from_start: float | None
    duration: float
    series: Sequence[Series]
    note: str = field(metadata=IF_ANY)

    def summary(self) -> list[str]:
        """Return a line for the plot and a line for each series."""
        lines = [
            f"{one.name}: {counted(one.count, 'value')}, {_number(one.min)} to {_number(one.max)}, "
            f"mean {_number(one.mean)}, last {_number(one.last)} {one.unit}".rstrip()
            for one in self.series
        ]
        return [f"Plot, {self.source}. {self.note}".rstrip(), *lines]


def _number(value: float | None) -> str:
    return "none" if value is None else f"{value:.5g}"


async def plot(source: Source, request: PlotRequest, report: Report = silent) -> Plot:
    """Draw the series of a request.

    Over time, each unit has its own panel. For `xy` the series are taken in pairs, and a point alone gives x and y;
    series of different topics are paired by the nearest time.

    Raises:
        BadInput: if there are no series, or not pairs of them.
        BadValue: if a size is out of range, or a field does not exist or is no number.
        NotFound: if none of the topics is there.
    """
    bounded("width", request.width, 300, MAX_SIDE, "px")
    bounded("height", request.height, 200, MAX_SIDE, "px")
    parts = [await _split(source, text) for text in request.series]
    if not parts:
        raise BadInput("Nothing to plot is given.", 'Give series such as ["/odom:twist.twist.linear.x"].')
    topics = list(dict.fromkeys(topic for topic, _ in parts))
    await _check_fields(source, parts)
    captures = {found.topic: found for found in await source.captures(topics, _keeping(parts, request), report)}
    missing = {topic: found.error for topic, found in captures.items() if isinstance(found, Missing)}
    if len(missing) == len(topics) or (missing and request.kind == "xy"):
        raise next(iter(missing.values()))
    found = [(capture, field) for topic, field in parts if isinstance(capture := captures[topic], Capture)]
    return await asyncio.to_thread(_drawn, source.words, found, request, [str(error) for error in missing.values()])


async def _split(source: Source, text: str) -> tuple[str, str]:
    """Split a series into topic and field at the last colon that follows the name of an existing topic, as names in
    recordings may contain colons; else at the first colon.
    """
    for at in [None, *(number for number in reversed(range(len(text))) if text[number] == ":")]:
        topic = text[:at].strip()
        if ":" not in topic:
            break
        with suppress(BadName, NotFound):  # live, no topic name contains a colon
            name = await source.name_of(topic)
            await source.type_of(name)
            return name, "" if at is None else text[at + 1 :].strip()
    topic, _, path = text.partition(":")
    return await source.name_of(topic.strip()), path.strip()


def _keeping(parts: Sequence[tuple[str, str]], request: PlotRequest) -> Callable[[Stream], Columns]:
    """Return the factory for `Source.captures` that keeps the fields drawn of each topic."""
    from ros2_mcp.ops.measure.columns import Columns, Room
    from ros2_mcp.ops.pictures.curves import drawn_fields

    room = Room()

    def keep(stream: Stream) -> Columns:
        paths = [field for topic, field in parts if topic == stream.topic]
        most = _XY_FIELDS if request.kind == "xy" else None
        fields = [one for path in paths for one in drawn_fields(stream.codec.definitions, stream.type, path, most)]
        unique = list({field.path: field for field in fields}.values())
        return Columns(stream.codec, stream.type, unique, room, whole_lists=True, is_replayed=stream.is_replayed)

    return keep


async def _check_fields(source: Source, parts: Sequence[tuple[str, str]]) -> None:
    """Raise BadValue for a field that does not exist, before any time is spent on measuring; missing topics are
    reported later.
    """
    from ros2_mcp.values.select import measurable  # with numpy: not before it is needed

    for topic, path in parts:
        try:
            type_name = await source.type_of(topic)
        except NotFound:
            continue
        if path:
            measurable(source.codec.definitions, type_name, [path])


def _drawn(title: str, found: Sequence[tuple[Capture[Columns], str]], request: PlotRequest, notes: list[str]) -> Plot:
    from ros2_mcp.ops.pictures import curves
    from ros2_mcp.pictures.plot import plotted

    is_xy, first = request.kind == "xy", found[0][0]
    captures = {capture.topic: capture for capture, _ in found}
    most = _XY_FIELDS if is_xy else None
    by_name: dict[str, FieldValues] = {}
    for capture, path in found:
        capture.kept.check()
        fields = curves.drawn_fields(capture.definitions, capture.type, path, most)
        by_name |= {value.name: value for value in curves.values_of(capture, fields)}
    values = list(by_name.values())
    for topic, capture in captures.items():
        troubles = capture.odd_times, capture.kept.skipped, capture.kept.bounds("The plot shows", capture.began_ns)
        notes += [f"{topic}: {trouble}" for trouble in troubles if trouble]
    if not is_xy and len(values) > curves.MAX_CURVES:
        shown = ([value for value in values if not value.is_constant] or values)[: curves.MAX_CURVES]
        left_out = [value.name for value in values if value.name not in {one.name for one in shown}]
        more = " and others" if len(left_out) > _LISTED else ""
        notes.append(f"Not shown, as there are too many: {', '.join(left_out[:_LISTED])}{more}. Choose fields.")
        values = shown
    elif len(values) > 2 * curves.MAX_CURVES:
        most = 2 * curves.MAX_CURVES
        raise BadInput(f"{len(values)} series are too many for one picture.", f"Give at most {most}.")
    series = [_series(value) for value in values]
    notes += [f"{topic} had no messages." for topic, capture in captures.items() if not capture.kept.seen]
    notes += [
        f"{topic}: {FromBefore.of(capture.kept.replayed, capture.kept.replayed_ns, capture.end_ns)}."
        for topic, capture in captures.items()
        if capture.kept.replayed
    ]
    notes += [
        f"{topic}: {one.dropped} messages were dropped: too many to keep."
        for topic, one in captures.items()
        if one.dropped
    ]
    figure = curves.against_each_other(values, title) if is_xy else curves.over_time(values, first, title)
    height = min(MAX_SIDE, max(request.height, 120 + _PANEL_PIXELS * len(figure.panels)))
    marks = " A red cross marks NaN, a wedge an infinity." if any(one.not_finite for one in series) else ""
    gaps = " Breaks are times without messages." if any(one.gaps for one in series) else ""
    what = "against each other" if is_xy else "over time"
    picture = plotted(figure, request.width, height, f"{len(series)} series {what}.{marks}{gaps}")
    return Plot(
        source=title,
        kind=request.kind,
        started_at=iso_time(first.start_ns),
        seconds_from_start=seconds_from_start(first.start_ns, first.began_ns),
        duration=first.duration_s,
        series=series,
        note=" ".join(notes),
        pictures=facts([picture]),
        images=[picture],
    )


def _series(value: FieldValues) -> Series:
    import numpy as np

    from ros2_mcp.ops.measure.signals import number
    from ros2_mcp.ops.pictures.curves import breaks

    finite = value.finite
    with np.errstate(over="ignore"):
        low, high, mean = (number(f(finite)) if len(finite) else None for f in (np.min, np.max, np.mean))
    first, last = (number(finite[at]) if len(finite) else None for at in (0, -1))
    return Series(
        name=value.name,
        unit=value.unit,
        count=len(finite),
        min=low,
        max=high,
        mean=mean,
        first=first,
        last=last,
        not_finite=len(value.values) - len(finite),
        gaps=int(breaks(value.times).sum()),
    )
