"""The fields of messages as curves, and the curves as the figure of a plot.

It imports numpy, so `plot.py` imports it only when something is drawn: listing the tools must not wait for that.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ros2_mcp.codec.cdr import Message
from ros2_mcp.codec.plot import COLOURS, Curve, Figure, Panel, Span
from ros2_mcp.codec.select import measurable
from ros2_mcp.codec.units import unit_of
from ros2_mcp.model.errors import BadInput, BadValue
from ros2_mcp.ops.measure.flow import GAP_FACTOR
from ros2_mcp.ops.measure.signals import Numbers, flat, pairs
from ros2_mcp.ops.results import iso_time
from ros2_mcp.ops.sources.source import Capture

MAX_CURVES = len(COLOURS)


@dataclass(frozen=True, slots=True)
class FieldValues:
    """The values of one field, with the time of each in seconds from the capture's beginning."""

    topic: str
    field: str
    unit: str
    times: Numbers
    values: Numbers

    @property
    def name(self) -> str:
        """As callers write it: `/odom:twist.twist.linear.x`."""
        return f"{self.topic}:{self.field}"

    @property
    def finite(self) -> Numbers:
        """The values without NaN and infinities."""
        return self.values[np.isfinite(self.values)]

    @property
    def is_constant(self) -> bool:
        """Whether all finite values are the same."""
        return not bool((self.finite != self.finite[:1]).any())


def values_of(
    capture: Capture, messages: Sequence[Message], path: str, max_fields: int | None = None
) -> Iterator[FieldValues]:
    """The values of each number that a path stands for; of a list, of each of its first elements.

    Without a path: of every number that is not in a list. At most `max_fields` of them.
    """
    fields = measurable(capture.definitions, capture.type, [path] if path else ())
    if not path:
        fields = [field for field in fields if not field.is_list]
    times = [max(sample.received_ns - capture.start_ns, 0) / 1e9 for sample in capture.samples]
    for field in fields[:max_fields]:
        unit = unit_of(capture.definitions, capture.type, field.path)
        points: list[tuple[float, Any]] = []
        for time, message in zip(times, messages, strict=True):
            try:
                points.append((time, field.value_in(message)))
            except BadValue:
                continue  # the list in this message is too short to have the element
        curves = {field.path: points}
        if field.is_list:
            # One element more than can be drawn, so that it is seen and said that some are not shown.
            longest = min(max((len(value) for _, value in points), default=0), MAX_CURVES + 1)
            curves = {
                f"{field.path}[{index}]": [(time, value[index]) for time, value in points if index < len(value)]
                for index in range(longest)
            }
        for name, curve in curves.items():
            at, values = flat([time for time, _ in curve]), flat([value for _, value in curve])
            yield FieldValues(capture.topic, name, unit, at, values)


def breaks(times: Numbers) -> NDArray[np.bool_]:
    """True at each value that came after a gap."""
    periods = np.diff(times)
    usual = float(np.median(periods)) if len(periods) > 2 else np.inf
    return np.concatenate(([False], periods > GAP_FACTOR * usual))[: len(times)]


def over_time(values: Sequence[FieldValues], capture: Capture, title: str) -> Figure:
    """A panel for each unit, over the time of the capture."""
    units = [value.unit for value in values]
    panels = [
        Panel([Curve(value.name, value.times, value.values, breaks(value.times)) for value in group], unit)
        for unit, group in groupby(sorted(values, key=lambda value: units.index(value.unit)), lambda value: value.unit)
    ]
    since = iso_time(capture.start_ns)[:-5].replace("T", " ")
    return Figure(panels or [Panel([])], title, f"seconds since {since} UTC", Span(0.0, max(capture.duration_s, 1e-3)))


def against_each_other(values: Sequence[FieldValues], title: str) -> Figure:
    """One panel with a curve for each pair of x and y.

    Raises:
        BadInput: if the values are not pairs.
    """
    if not values or len(values) % 2:
        raise BadInput(
            f"{len(values)} series cannot be drawn against each other: pairs of x and y are needed.",
            'Give ["/odom:pose.pose.position"], or ["/odom:pose.pose.position.x", "/odom:pose.pose.position.y"].',
        )
    across, up = values[::2], values[1::2]
    curves: list[Curve] = []
    for x, y in zip(across, up, strict=True):
        matched = pairs(x.times, y.times)
        in_x, in_y = (np.array([pair[side] for pair in matched], np.intp) for side in (0, 1))
        name = f"{y.name} over {x.field if x.topic == y.topic else x.name}"
        curves.append(Curve(name, x.values[in_x], y.values[in_y], breaks(x.times[in_x])))
    x_unit, y_unit = _common_unit(across), _common_unit(up)
    x_name = across[0].name if len(curves) == 1 else "x"
    return Figure(
        [Panel(curves, y_unit)],
        f"{title}; ring: begin, disc: end",
        f"{x_name} [{x_unit}]" if x_unit else x_name,
        equal=bool(x_unit) and x_unit == y_unit,
        ends=True,
    )


def _common_unit(values: Sequence[FieldValues]) -> str:
    units = {value.unit for value in values}
    return units.pop() if len(units) == 1 else ""
