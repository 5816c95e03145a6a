"""Waiting until a condition on a topic holds; in a recording, finding the first time that it held."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from time import monotonic
from typing import TYPE_CHECKING, Any

from ros2_mcp.model.errors import BadData, BadValue, NotFound
from ros2_mcp.model.samples import Sample
from ros2_mcp.ops.results import HIDDEN, Report, iso_time, reporting, silent
from ros2_mcp.ops.sources.selection import undecodable
from ros2_mcp.ops.sources.source import Source, Stream

if TYPE_CHECKING:
    from ros2_mcp.ops.measure.expression import Condition

_TURN_SAMPLES = 200
"""Looked at in one go of a thread: some 10 ms, so that a cancelled call ends at once."""


@dataclass(frozen=True, slots=True)
class Wait:
    """Whether a condition came true, with the message that met it; else the last one that came.

    `looked_at` messages were examined; `undecided` of them had no answer (a list too short, a division by zero).
    `values` are the fields that the condition names. `dropped` messages came too fast to be looked at.
    """

    topic_name: str
    topic_type: str
    condition: str
    met: bool
    at: str
    waited: float
    looked_at: int
    undecided: int
    dropped: int
    values: Mapping[str, Any]
    message: dict[str, Any] | None
    source: str
    note: str
    is_live: bool = field(default=True, metadata=HIDDEN)

    def summary(self) -> str:
        """One line."""
        outcome = "is met" if self.met else "was not met"
        when = f"after {self.waited:.3f} s" if self.is_live else f"in {self.source}, {self.at}"
        values = ", ".join(f"{path} = {_brief(value)}" for path, value in self.values.items())
        line = f"{self.topic_name}: {self.condition} {outcome} {when} ({values or 'no message'})."
        return f"{line} {self.note}".rstrip()


def _brief(value: Any) -> str:
    text = str(value)
    return text if len(text) <= 80 else "…"


@dataclass(slots=True)
class _Search:
    """What has been seen so far."""

    condition: Condition
    last: Sample | None = None
    met: bool = False
    looked_at: int = 0
    undecided: int = 0
    undecodable: int = 0

    def look(self, stream: Stream, samples: Sequence[Sample]) -> bool:
        """Examines samples up to the one that meets the condition; true if there is one."""
        for sample in samples:
            try:
                message = stream.codec.decode(stream.type, sample.data)
            except BadData:
                self.undecodable += 1
                continue
            self.last = sample
            self.looked_at += 1
            holds = self.condition.holds(message)
            self.undecided += holds is None
            if holds:
                self.met = True
                return True
        return False


async def wait_until(
    source: Source, topic: str, text: str, report: Report = silent, *, max_bytes: int = 32_000
) -> Wait:
    """Looks at every message until one meets the condition, or the source's time is over.

    Raises:
        BadInput: for what is not a condition.
        BadValue: for a field that does not exist, or a time out of range.
        NotFound: if the topic does not appear in that time.
        TypeConflict: if it has several types.
    """
    from ros2_mcp.ops.measure.expression import condition

    started = monotonic()
    with contextlib.suppress(NotFound):  # it may appear in time
        condition(source.codec.definitions, await source.type_of(topic), text)
    async with source.follow(topic) as stream:
        search = _Search(condition(stream.codec.definitions, stream.type, text))

        def progress() -> str:
            return f"{stream.topic}: {search.looked_at} messages, not met"

        async with reporting(report, source.duration_s, progress):
            await _examine(stream, search)
        return await asyncio.to_thread(_result, source, stream, search, monotonic() - started, max_bytes)


async def _examine(stream: Stream, search: _Search) -> None:
    async for batch in stream.batches:
        for begin in range(0, len(batch), _TURN_SAMPLES):
            part = batch[begin : begin + _TURN_SAMPLES]
            if await asyncio.to_thread(search.look, stream, part):
                return


def _result(source: Source, stream: Stream, search: _Search, waited_s: float, max_bytes: int) -> Wait:
    last, paths = search.last, search.condition.fields
    return Wait(
        stream.topic,
        stream.type,
        search.condition.text,
        search.met,
        iso_time(last.received_ns) if last else "",
        round(waited_s, 6),
        search.looked_at,
        search.undecided,
        stream.counts.dropped,
        _shown(stream, last, paths, 2000) if last and paths else {},
        _shown(stream, last, (), max_bytes // 2) if last else None,
        source.words,
        _note(stream, search),
        source.is_live,
    )


def _shown(stream: Stream, sample: Sample, paths: Sequence[str], max_bytes: int) -> dict[str, Any]:
    from ros2_mcp.codec.render import RenderOptions, render

    message = stream.codec.decode(stream.type, sample.data)
    if not paths:
        return render(stream.codec.definitions, stream.type, message, options=RenderOptions(max_bytes=max_bytes)).value
    values: dict[str, Any] = {}
    for path in paths:
        options = RenderOptions(max_array=8, max_string=200, max_bytes=max_bytes, fields=[path])
        try:
            values |= render(stream.codec.definitions, stream.type, message, options=options).value
        except BadValue:
            values[path] = None
    return values


def _note(stream: Stream, search: _Search) -> str:
    notes: list[str] = []
    if search.undecodable:
        notes.append(undecodable(search.undecodable))
    elif not search.looked_at:
        notes.append("No message came." if stream.publishers else "No message came: nobody publishes on it.")
    if search.undecided:
        notes.append(f"{search.undecided} messages had no answer (a list too short, or a division by zero).")
    if dropped := stream.counts.dropped:
        notes.append(f"{dropped} messages came too fast to be looked at.")
    return " ".join(notes)
