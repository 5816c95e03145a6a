"""Plot numeric fields of one topic over time."""

from __future__ import annotations

import asyncio
import base64
import math
import struct
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from time import monotonic
from typing import TYPE_CHECKING, Any, cast

from ros2_mcp.model.aside import aside
from ros2_mcp.model.errors import BadData, NotFound
from ros2_mcp.model.samples import Sample
from ros2_mcp.model.text import counted, named
from ros2_mcp.view.look import Content, Look, PageContext, Panel, Shown, when
from ros2_mcp.view.panels.values import first_topic

if TYPE_CHECKING:
    from ros2_mcp.values.cdr import Codec
    from ros2_mcp.values.select import FieldPath

WINDOW_NS = 60_000_000_000
"""The part of a recording that is shown before its time; the page keeps as much of live data."""
_STEP_S = 0.025
"""Least seconds between two messages that are drawn: a plot is a thousand pixels wide."""
_RECORDED_STEP_NS = 50_000_000
_GATHERED_S = 0.2
"""Messages received in this time are sent together."""
_OVERLAP_S = 2.0
"""Rows of this many seconds are sent repeatedly, so that a slow page does not miss any."""
_MOST_CURVES = 24
_MOST_ELEMENTS = 8
"""Elements of a list, such as joint positions."""


@dataclass
class _Rows:
    """Times and values of one topic.

    `first` is the number of the first row that is kept; `units` has the unit of each curve by its name, in order.
    `from_before` is set if the last message was sent before the subscription: its time is when it was sent.
    """

    topic: str = ""
    kind: str = ""
    paths: Sequence[FieldPath] = ()
    units: dict[str, str] = field(default_factory=dict[str, str])
    since_s: float = 0.0
    first: int = 0
    from_before: bool = False
    times: deque[float] = field(default_factory=deque[float])
    values: deque[Sequence[float]] = field(default_factory=deque[Sequence[float]])

    def add(self, codec: Codec, sample: Sample, is_old: bool) -> None:
        """Add a message; if it has curves that earlier messages lacked, begin anew."""
        from ros2_mcp.values.select import measurable
        from ros2_mcp.values.units import unit_of

        message = codec.decode(self.kind, sample.data)
        if not self.paths:
            self.paths = [
                one for one in measurable(codec.definitions, self.kind) if not one.path.endswith("covariance")
            ]
        at_s, self.from_before = when(sample, is_old)["at_s"], is_old
        found = {name: (path, value) for name, path, value in islice(_numbers(self.paths, message), _MOST_CURVES)}
        for name, (path, _) in found.items():
            if name not in self.units and len(self.units) < _MOST_CURVES:
                self.units[name] = unit_of(codec.definitions, self.kind, path)
                self.since_s, self.first = at_s, 0
                self.times.clear()
                self.values.clear()
        self.times.append(at_s)
        self.values.append([found[name][1] if name in found else math.nan for name in self.units])

    def forget(self, before_s: float) -> None:
        """Drop rows before that time (Unix time, s)."""
        while len(self.times) > 1 and self.times[0] < before_s:
            self.times.popleft()
            self.values.popleft()
            self.first += 1

    def told(self) -> Mapping[str, Any]:
        """Return all rows: `bulk` has time and values of each as little-endian 64-bit floats.

        NaN means that the message lacks the value, infinity that the value is not finite.
        """
        rows = [(at, *values) for at, values in zip(self.times, self.values, strict=True)]
        packed = b"".join(struct.pack(f"<{len(row)}d", *row) for row in rows)
        return {
            "topic": self.topic,
            "type": self.kind,
            "fields": [{"name": name, "unit": unit} for name, unit in self.units.items()],
            "since_s": self.since_s,
            "first": self.first,
            "at_s": self.times[-1] if self.times else None,
            "from_before": self.from_before,
            "bulk": base64.b64encode(packed).decode("ascii"),
        }


class PlotPanel(Panel):
    """Plots numeric fields of a topic. The server sends only recent rows; the page accumulates and draws them."""

    name = "plot"
    shows_kind = "plot"
    period_s = _GATHERED_S

    def __init__(self, page: PageContext) -> None:
        super().__init__(page)
        self._shown = Shown()
        self._rows = _Rows()
        self._read_ns = (0, 0)

    async def show(self, look: Look) -> Content | None:
        """Return recent rows, or for a recording the minute before the time shown."""
        topic = look.chosen or await first_topic(look.source)
        if not topic:
            raise NotFound("There is no topic to plot.")
        return await (self._live(look, topic) if look.source.is_live else self._recorded(look, topic))

    async def _live(self, look: Look, topic: str) -> Content | None:
        until, has_come, rate_hz = monotonic() + _GATHERED_S, False, None
        while (began := monotonic()) < until:
            found = await self._shown.newer(look.robot, topic)
            if found is None:
                break
            sample, newest, listening = found
            rate_hz = newest.rate_hz()
            if self._rows.topic != topic or self._rows.kind != listening.type:
                await look.robot.values.learn(listening.type)
                self._rows = _Rows(topic, listening.type)
            await self._take(look.robot.values.codec, sample, listening.is_from_before(sample))
            has_come = True
            await asyncio.sleep(max(began + _STEP_S - monotonic(), 0.0))
        if not has_come:
            why = f"No message has come on {named(topic)} yet."
            return None if self._shown.sample else {"topic": topic, "why": why}
        self._rows.forget(self._rows.times[-1] - _OVERLAP_S)
        drawn_hz = 1 / _STEP_S
        notes = (
            [f"At most {drawn_hz:.0f} of {rate_hz:.0f} messages a second are drawn."]
            if rate_hz and rate_hz > drawn_hz
            else []
        )
        return {**self._rows.told(), "whole": False, "rate_hz": rate_hz, "notes": notes}

    async def _take(self, codec: Codec, sample: Sample, is_old: bool = False) -> None:
        await aside(sample.size, self._rows.add, codec, sample, is_old)
        if not self._rows.units:
            raise NotFound(f"{named(self._rows.topic)} is a {named(self._rows.kind)}, which has no numbers to plot.")

    async def _recorded(self, look: Look, topic: str) -> Content:
        begin_ns, end_ns = look.source.covers_ns or (0, 0)
        begin_ns = max(begin_ns, end_ns - WINDOW_NS)
        kind = await look.source.type_of(topic)
        read_from, read_to = self._read_ns
        if (self._rows.topic, self._rows.kind) != (topic, kind) or not read_from <= begin_ns <= read_to <= end_ns:
            await look.robot.values.learn(kind)
            self._rows, read_to = _Rows(topic, kind), begin_ns
        self._read_ns = (0, 0)  # after a cancellation, reading begins anew
        last_ns, damaged = 0, 0
        async with look.source.part(read_to, end_ns).follow(topic, latched=False) as stream:
            async for batch in stream.batches:
                for sample in batch:
                    if sample.received_ns - last_ns < _RECORDED_STEP_NS:
                        continue
                    last_ns = sample.received_ns
                    try:
                        await self._take(stream.codec, sample)
                    except BadData:
                        damaged += 1
                await asyncio.sleep(0)
        self._rows.forget(begin_ns / 1e9)
        self._read_ns = begin_ns, end_ns
        notes = [f"{counted(damaged, 'message')} could not be decoded."] if damaged else []
        if not self._rows.times:
            return {"topic": topic, "why": f"The recording has no message of {named(topic)} in the minute before."}
        return {**self._rows.told(), "whole": True, "rate_hz": None, "notes": notes}


def _numbers(paths: Sequence[FieldPath], message: object) -> Iterator[tuple[str, str, float]]:
    """Yield name, path and value of each number.

    Elements of a list take their names from the field `name`, if it has as many. Values that are not finite become
    infinite, which is a gap in the line.
    """
    found: Any = getattr(message, "name", None)
    names = cast("list[str]", found) if isinstance(found, list) else []
    for path in paths:
        value: Any = path.value_in(message)
        if not path.is_list:
            yield path.path, path.path, _finite(value)
            continue
        has_names = len(names) == len(value)
        for index, one in enumerate(value[:_MOST_ELEMENTS]):
            yield f"{path.path}[{names[index] if has_names else index}]", path.path, _finite(one)


def _finite(value: Any) -> float:
    return float(value) if math.isfinite(value) else math.inf
