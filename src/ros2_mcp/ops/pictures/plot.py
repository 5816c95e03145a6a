"""Numeric fields over time, or one against the other, as a picture with a summary of the numbers."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING, Any

from ros2_mcp.guard.policy import bounded
from ros2_mcp.model import names
from ros2_mcp.model.errors import BadInput, BadValue
from ros2_mcp.model.pictures import MAX_SIDE, Picture
from ros2_mcp.ops.measure.flow import GAP_FACTOR
from ros2_mcp.ops.results import Report, WithPictures, facts, iso_time, silent
from ros2_mcp.ops.sources.source import Capture, Missing, Source

if TYPE_CHECKING:
    from ros2_mcp.codec.cdr import Message
    from ros2_mcp.codec.plot import Figure, Panel
    from ros2_mcp.ops.measure.signals import Numbers

MAX_CURVES = 12
_PANEL_PIXELS = 140
_LISTED = 8


@dataclass(frozen=True, slots=True)
class Look:
    """How to draw: over time (`time`), or pairs of series against each other (`xy`); the size in pixels."""

    kind: str = "time"
    width: int = 1000
    height: int = 640


@dataclass(frozen=True, slots=True)
class Series:
    """One numeric field over the time of measuring; numbers over its finite values, null where there are none.

    `unit` is empty where it is not known. `gaps` counts the silences that are breaks in the curve.
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
    """What the picture shows. Times by the receiver's clock; `note` names what is not shown, and why."""

    source: str
    kind: str
    started_at: str
    duration: float
    series: Sequence[Series]
    note: str

    def summary(self) -> str:
        """A line for each series."""
        lines = [
            f"{each.name}: {each.count} value(s), {_number(each.min)} to {_number(each.max)}, "
            f"mean {_number(each.mean)}, last {_number(each.last)} {each.unit}".rstrip()
            for each in self.series
        ]
        return "\n".join([f"Plot, {self.source}. {self.note}".rstrip(), *lines])


def _number(value: float | None) -> str:
    return "none" if value is None else f"{value:.5g}"


async def plot(source: Source, wanted: Sequence[str], look: Look | None = None, report: Report = silent) -> Plot:
    """Draws fields such as `/odom:twist.twist.linear.x`; a topic or message alone stands for the numbers in it.

    Over time there is a panel for each unit. For `xy` the series are taken in pairs, and a point alone stands for its
    x and y; series of different topics are paired by the nearest time.

    Raises:
        BadInput: if nothing is wanted, or the series are not pairs.
        BadValue: if a size is out of range, or a field does not exist or is no number.
        NotFound: if none of the topics is there.
    """
    look = look or Look()
    bounded("width", look.width, 300, MAX_SIDE, "px")
    bounded("height", look.height, 200, MAX_SIDE, "px")
    parts = [_parted(each) for each in wanted]
    if not parts:
        raise BadInput("Nothing to plot is given.", 'Give series such as ["/odom:twist.twist.linear.x"].')
    topics = list(dict.fromkeys(topic for topic, _ in parts))
    await _check_fields(source, parts)
    captures = {each.topic: each for each in await source.captures(topics, report)}
    found = [(captures[topic], field) for topic, field in parts]
    missing = {each.topic: each.error for each in captures.values() if isinstance(each, Missing)}
    if len(missing) == len(topics) or (missing and look.kind == "xy"):
        raise next(iter(missing.values()))
    kept = [(capture, field) for capture, field in found if isinstance(capture, Capture)]
    notes = [str(error) for error in missing.values()]
    return await asyncio.to_thread(_plotted, source.words, kept, look, notes)


def _parted(series: str) -> tuple[str, str]:
    topic, _, field = series.partition(":")
    return names.absolute(topic.strip()), field.strip()


async def _check_fields(source: Source, parts: Sequence[tuple[str, str]]) -> None:
    """Raises the error of a field that does not exist before any time is spent; missing topics are told later."""
    from ros2_mcp.codec.select import measurable
    from ros2_mcp.model.errors import NotFound

    for topic, field in parts:
        try:
            type_name = await source.type_of(topic)
        except NotFound:
            continue
        if field:
            measurable(source.codec.definitions, type_name, [field])


# ── values ───────────────────────────────────────────────────────────────────────────────────────────────────────


@dataclass(frozen=True, slots=True)
class _Values:
    """The values of one field, with the time of each in seconds from the capture's beginning."""

    topic: str
    field: str
    unit: str
    times: Numbers
    values: Numbers

    @property
    def name(self) -> str:
        return f"{self.topic}:{self.field}"


def _values_of(capture: Capture, messages: Sequence[Message], field: str, most: int | None) -> Iterator[_Values]:
    """The values of each number that a path stands for, of lists of each element; at most so many fields."""
    from ros2_mcp.codec.select import measurable
    from ros2_mcp.codec.units import unit_of
    from ros2_mcp.ops.measure.signals import flat

    readings = measurable(capture.definitions, capture.type, [field] if field else ())
    if not field:
        readings = [each for each in readings if not each.is_list]
    times = [max(sample.received_ns - capture.start_ns, 0) / 1e9 for sample in capture.samples]
    for each in readings[:most]:
        found = [(time, _value(each, message)) for time, message in zip(times, messages, strict=True)]
        unit = unit_of(capture.definitions, capture.type, each.path)
        for path, points in _split(each.path, found) if each.is_list else [(each.path, found)]:
            kept = [(time, value) for time, value in points if value is not None]
            yield _Values(capture.topic, path, unit, flat([at for at, _ in kept]), flat([value for _, value in kept]))


def _value(reading: Any, message: object) -> Any:
    """The value in a message, or None where a list has no such element."""
    try:
        return reading.value_in(message)
    except BadValue:
        return None


def _split(path: str, found: Sequence[tuple[float, Any]]) -> Iterator[tuple[str, list[tuple[float, Any]]]]:
    """A list over time as the first of its elements over time, one more than are drawn."""
    longest = max((len(value) for _, value in found if value is not None), default=0)
    for index in range(min(longest, MAX_CURVES + 1)):
        yield (
            f"{path}[{index}]",
            [(at, value[index]) for at, value in found if value is not None and index < len(value)],
        )


def _series(values: _Values, gaps: int) -> Series:
    import numpy as np

    from ros2_mcp.ops.measure.signals import number

    finite = values.values[np.isfinite(values.values)]
    with np.errstate(over="ignore"):
        low, high, mean = (number(f(finite)) if len(finite) else None for f in (np.min, np.max, np.mean))
    first, last = (number(finite[at]) if len(finite) else None for at in (0, -1))
    odd = len(values.values) - len(finite)
    return Series(values.name, values.unit, len(finite), low, high, mean, first, last, odd, gaps)


def _breaks(times: Numbers) -> Any:
    """True at each value that came after a gap."""
    import numpy as np

    periods = np.diff(times)
    usual = float(np.median(periods)) if len(periods) > 2 else np.inf
    return np.concatenate(([False], periods > GAP_FACTOR * usual))[: len(times)]


# ── pictures ─────────────────────────────────────────────────────────────────────────────────────────────────────


def _plotted(words: str, found: Sequence[tuple[Capture, str]], look: Look, notes: list[str]) -> Plot:
    most = 2 if look.kind == "xy" else None
    readable = {topic: capture.readable() for topic, capture in {each.topic: each for each, _ in found}.items()}
    by_name = {
        each.name: each for capture, field in found for each in _values_of(*readable[capture.topic][:2], field, most)
    }
    values, first = list(by_name.values()), found[0][0]
    notes += [f"{topic}: {trouble}" for topic, (_, _, trouble) in readable.items() if trouble]
    if look.kind == "time":
        values, left_out = _chosen(values)
        notes += left_out
    elif len(values) > 2 * MAX_CURVES:
        raise BadInput(f"{len(values)} series are too many for one picture.", f"Give at most {2 * MAX_CURVES}.")
    series = [_series(each, int(_breaks(each.times).sum())) for each in values]
    notes += [f"{topic} was silent." for topic in dict.fromkeys(w.topic for w, _ in found if not w.samples)]
    dropped = {capture.topic: capture.dropped for capture, _ in found if capture.dropped}
    notes += [f"{topic}: {count} messages were too much to keep." for topic, count in dropped.items()]
    figure = _against_each_other(values, words) if look.kind == "xy" else _over_time(values, first, words)
    picture = _picture(figure, look, series)
    return Plot(
        source=words,
        kind=look.kind,
        started_at=iso_time(first.start_ns),
        duration=first.duration_s,
        series=series,
        note=" ".join(notes),
        pictures=facts([picture]),
        images=[picture],
    )


def _chosen(values: list[_Values]) -> tuple[list[_Values], list[str]]:
    """As many as can be drawn; only those that change, if not all can."""
    if len(values) <= MAX_CURVES:
        return values, []
    kept = ([each for each in values if _changes(each)] or values)[:MAX_CURVES]
    left_out = [each.name for each in values if each.name not in {one.name for one in kept}]
    more = " and others" if len(left_out) > _LISTED else ""
    return kept, [f"Not shown, as there are too many: {', '.join(left_out[:_LISTED])}{more}. Choose fields."]


def _changes(values: _Values) -> bool:
    import numpy as np

    finite = values.values[np.isfinite(values.values)]
    return len(finite) > 1 and bool((finite != finite[0]).any())


def _over_time(values: Sequence[_Values], capture: Capture, words: str) -> Figure:
    from ros2_mcp.codec.plot import Curve, Figure, Panel, Span

    ordered = sorted(values, key=lambda each: [v.unit for v in values].index(each.unit))
    panels: list[Panel] = []
    for unit, group in groupby(ordered, key=lambda each: each.unit):
        panels.append(Panel([Curve(v.name, v.times, v.values, _breaks(v.times)) for v in group], unit))
    since = iso_time(capture.start_ns)[:-5].replace("T", " ")
    return Figure(panels or [Panel([])], words, f"seconds since {since} UTC", Span(0.0, max(capture.duration_s, 1e-3)))


def _against_each_other(values: Sequence[_Values], words: str) -> Figure:
    from ros2_mcp.codec.plot import Figure, Panel

    if not values or len(values) % 2:
        raise BadInput(
            f"{len(values)} series cannot be drawn against each other: pairs of x and y are needed.",
            'Give ["/odom:pose.pose.position"], or ["/odom:pose.pose.position.x", "/odom:pose.pose.position.y"].',
        )
    across, up = values[::2], values[1::2]
    curves = [_pair(x, y) for x, y in zip(across, up, strict=True)]
    x_unit, y_unit = _common_unit(across), _common_unit(up)
    name = across[0].name if len(curves) == 1 else "x"
    title = f"{words}; ring: begin, disc: end"
    x_label = f"{name} [{x_unit}]" if x_unit else name
    return Figure([Panel(curves, y_unit)], title, x_label, equal=bool(x_unit) and x_unit == y_unit, ends=True)


def _common_unit(values: Sequence[_Values]) -> str:
    units = {each.unit for each in values}
    return units.pop() if len(units) == 1 else ""


def _pair(x: _Values, y: _Values) -> Any:
    import numpy as np

    from ros2_mcp.codec.plot import Curve
    from ros2_mcp.ops.measure.signals import pairs

    matched = pairs(x.times, y.times)
    first = np.array([one for one, _ in matched], np.intp)
    second = np.array([other for _, other in matched], np.intp)
    name = f"{y.name} over {x.field if x.topic == y.topic else x.name}"
    return Curve(name, x.values[first], y.values[second], _breaks(x.times[first]))


def _picture(figure: Figure, look: Look, series: Sequence[Series]) -> Picture:
    from ros2_mcp.codec.plot import plotted

    height = min(MAX_SIDE, max(look.height, 120 + _PANEL_PIXELS * len(figure.panels)))
    what = "against each other" if look.kind == "xy" else "over time"
    odd = " A red cross marks NaN, a wedge an infinity." if any(each.not_finite for each in series) else ""
    gaps = " Breaks are times without messages." if any(each.gaps for each in series) else ""
    return plotted(figure, look.width, height, f"{len(series)} series {what}.{odd}{gaps}")
