"""An agent's activity during a recording: the audit lines in the recording, or else the audit of this machine."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, cast

from ros2_mcp.guard.chain import newest
from ros2_mcp.model.errors import BadData
from ros2_mcp.model.samples import Sample
from ros2_mcp.model.text import named
from ros2_mcp.model.times import iso_time
from ros2_mcp.ops.memory.record import CALLS
from ros2_mcp.ops.results.results import silent
from ros2_mcp.ops.sources.source import Missing, Source, Stream

_MOST_LINES = 100_000
"""Lines of the audit that are searched: they are read in a second."""
_BEFORE_NS = 60_000_000_000
"""Commands from the minute before the recording may still have been active."""

Entry = Mapping[str, Any]


class RecordedActs:
    """The audit lines of a recording's time, read once."""

    def __init__(self, source: Source) -> None:
        self._source = source
        self._read: tuple[Sequence[tuple[str, Entry]], str] | None = None

    async def until(self, until_ns: int, folder: Path) -> tuple[Sequence[Entry], str]:
        """Return the lines up to a time, the oldest first, and a sentence about their origin.

        `folder` is that of this machine's audit.
        """
        if self._read is None:
            self._read = await self._lines(folder)
        lines, origin = self._read
        until = iso_time(until_ns)
        return [entry for at, entry in lines if at <= until], origin

    async def _lines(self, folder: Path) -> tuple[Sequence[tuple[str, Entry]], str]:
        (found,) = await self._source.captures([CALLS], _Calls, silent)
        if not isinstance(found, Missing):
            return found.kept.lines, f"At the time shown, as recorded in {named(CALLS)}"
        begin_ns, end_ns = self._source.covers_ns or (0, 0)
        span = iso_time(max(begin_ns - _BEFORE_NS, 0)), iso_time(end_ns)
        lines = await asyncio.to_thread(_audited, folder, *span)
        robot = named(folder.parent.name)
        return lines, f"At the time shown, from the audit of {robot} on this machine; the recording has none"


class _Calls:
    """The audit lines in a recording, each with the time of its message, which is the clock of the other topics."""

    def __init__(self, stream: Stream) -> None:
        self.lines: list[tuple[str, Entry]] = []
        self._codec, self._type = stream.codec, stream.type

    def add(self, samples: Sequence[Sample]) -> None:
        """Add messages; messages that are not audit lines are skipped."""
        for sample in samples:
            try:
                message: Any = self._codec.decode(self._type, sample.data)
                entry: Any = json.loads(message.data)
            except (BadData, ValueError, RecursionError, AttributeError):
                continue
            if isinstance(entry, dict):
                at = iso_time(sample.received_ns)
                self.lines.append((at, {**cast("dict[str, Any]", entry), "time": at}))


def _audited(folder: Path, begin: str, end: str) -> list[tuple[str, Entry]]:
    found: list[tuple[str, Entry]] = []
    for entry in islice(newest(folder), _MOST_LINES):
        at = str(entry.get("time", ""))
        if at < begin:
            break
        if at <= end:
            found.append((at, entry))
    return found[::-1]
