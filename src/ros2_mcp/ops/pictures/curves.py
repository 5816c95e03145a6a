"""The fields of messages as curves, and the curves as the figure of a plot.

It imports NumPy, so `plot.py` imports it only for drawing: listing the tools must not wait for that.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from ros2_mcp.model.errors import BadInput
from ros2_mcp.ops.measure.columns import Columns, seconds
from ros2_mcp.ops.measure.flow import GAP_FACTOR, usual_s
from ros2_mcp.ops.measure.signals import Numbers, pairs
from ros2_mcp.ops.results.results import iso_time
from ros2_mcp.ops.sources.source import Capture
from ros2_mcp.pictures.plot import COLOURS, Curve, Figure, Panel, Span
from ros2_mcp.values.definitions import Definitions
from ros2_mcp.values.select import FieldPath, measurable
from ros2_mcp.values.units import unit_of

MAX_CURVES = len(COLOURS)


@dataclass(frozen=True, slots=True)
class FieldValues:
    """The values of one field, and their times in seconds from the start of the capture."""

    topic: str
    field: str
    unit: str
    times: Numbers
    values: Numbers

    @property
    def name(self) -> str:
        """The name as callers write it: `/odom:twist.twist.linear.x`."""
        return f"{self.topic}:{self.field}"

    @property
    def finite(self) -> Numbers:
        """The finite values."""
        return self.values[np.isfinite(self.values)]

    @property
    def is_constant(self) -> bool:
        """Whether all finite values are equal."""
        return not bool((self.finite != self.finite[:1]).any())


def drawn_fields(definitions: Definitions, type_name: str, path: str, most: int | None = None) -> list[FieldPath]:
    """Return the fields of a path, at most `most`; without a path, all numbers that are not in a list."""
    fields = measurable(definitions, type_name, [path] if path else ())
    return [field for field in fields if path or not field.is_list][:most]


def values_of(capture: Capture[Columns], fields: Sequence[FieldPath]) -> Iterator[FieldValues]:
    """Yield the values of each field; for a list, the values of each of its first elements."""
    kept = capture.kept
    times = np.maximum(seconds(kept.read_ns, capture.start_ns), 0.0)
    by_path = {column.path.path: column for column in kept.columns}
    for path in dict.fromkeys(field.path for field in fields):
        column, unit = by_path[path], unit_of(capture.definitions, capture.type, path)
        at, values = times[column.rows], column.values
        if not column.path.is_list:
            yield FieldValues(capture.topic, path, unit, at, values)
            continue
        lengths = column.lengths
        begins = np.cumsum(lengths) - lengths
        # One element more than can be drawn, so that the caller notices that some are not shown.
        for index in range(min(int(lengths.max(initial=0)), MAX_CURVES + 1)):
            has = lengths > index
            yield FieldValues(capture.topic, f"{path}[{index}]", unit, at[has], values[begins[has] + index])


def breaks(times: Numbers) -> NDArray[np.bool_]:
    """Return True for each value that follows a gap."""
    periods = np.diff(times)
    usual = usual_s(periods) if len(periods) > 2 else np.inf
    return np.concatenate(([False], periods > GAP_FACTOR * usual))[: len(times)]


def over_time(values: Sequence[FieldValues], capture: Capture[Columns], title: str) -> Figure:
    """Return a figure with a panel for each unit, over the time of the capture; for a recording in seconds from its
    start.
    """
    units = [value.unit for value in values]
    zero_ns = capture.zero_ns
    begin_s = (capture.start_ns - zero_ns) / 1e9
    panels = [
        Panel([Curve(value.name, value.times + begin_s, value.values, breaks(value.times)) for value in group], unit)
        for unit, group in groupby(sorted(values, key=lambda value: units.index(value.unit)), lambda value: value.unit)
    ]
    since = f"seconds since {iso_time(zero_ns)[:-5].replace('T', ' ')} UTC"
    span = Span(begin_s, begin_s + max(capture.duration_s, 1e-3))
    return Figure(
        panels or [Panel([])],
        title,
        f"{since}, the recording's beginning" if capture.began_ns is not None else since,
        span,
    )


def against_each_other(values: Sequence[FieldValues], title: str) -> Figure:
    """Return a figure of one panel with a curve for each pair of x and y.

    Raises:
        BadInput: if the number of series is 0 or odd.
    """
    if not values or len(values) % 2:
        raise BadInput(
            f"{len(values)} series cannot be drawn against each other: pairs of x and y are needed.",
            'Give ["/odom:pose.pose.position"], or ["/odom:pose.pose.position.x", "/odom:pose.pose.position.y"].',
        )
    across, up = values[::2], values[1::2]
    curves: list[Curve] = []
    for x, y in zip(across, up, strict=True):
        in_x, in_y = pairs(x.times, y.times)
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
