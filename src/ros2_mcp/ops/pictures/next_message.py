"""Read the next message of a topic, for example to draw it."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import Any

from ros2_mcp.model.errors import BadData, TimedOut, TypeConflict
from ros2_mcp.model.samples import Sample
from ros2_mcp.model.text import named
from ros2_mcp.model.times import recorded_time
from ros2_mcp.ops.results.results import Report, reporting
from ros2_mcp.ops.sources.from_before import from_before
from ros2_mcp.ops.sources.selection import undecodable
from ros2_mcp.ops.sources.source import Source

_TRIED = 32
"""The most messages of a recording that are tried until one can be decoded; damaged messages are rare."""


@dataclass(frozen=True, slots=True)
class Next:
    """A message with its sample, and in words its source.

    `note` gives the time of recording or the age of a replayed message, and the number of messages skipped because they
    could not be decoded. `skipped` holds only the latter; `age` only the age of a replayed message.
    """

    message: Any
    sample: Sample
    source: str
    note: str
    skipped: str = ""
    age: str = ""


async def next_message(source: Source, topic: str, type_name: str, report: Report) -> Next:
    """Return the next message of a topic that can be decoded. If several are waiting live, or were kept by a latched
    topic, return the newest.

    Raises:
        NotFound: if the topic is not there.
        TypeConflict: if it has another type.
        TimedOut: if no message came.
        BadData: if no message could be decoded.
    """
    topic, source = await source.name_of(topic), source.judging()
    async with reporting(report, source.duration_s, f"waiting for {topic}"):
        try:
            return await _next(source, topic, type_name, 1)
        except BadData:
            if source.is_live:
                raise
            return await _next(source, topic, type_name, _TRIED)


async def _next(source: Source, topic: str, type_name: str, limit: int) -> Next:
    skipped, trouble = 0, BadData("")
    async with source.follow(topic, limit=limit) as stream:
        if stream.type != type_name:
            raise TypeConflict(f"{topic} is a {named(stream.type)}, not a {type_name}.", "ros2_topic_list shows types.")
        async for batch in stream.batches:
            # Live, and for a recording without a start time, the newest is tried first.
            for sample in batch[::-1] if source.is_live or stream.from_end else batch:
                try:
                    message = await asyncio.to_thread(stream.codec.decode, stream.type, sample.data)
                except BadData as error:
                    skipped, trouble = skipped + 1, error
                    continue
                left_out = undecodable(skipped, str(trouble)) if skipped else ""
                recorded = (
                    "" if source.is_live else f"Recorded at {recorded_time(sample.received_ns, source.began_ns)}."
                )
                old = from_before(source, stream, [sample])
                note = " ".join(filter(None, (left_out, recorded, f"{old}." if old.count else "")))
                where = old.beside(source.words_after(stream.covered_s))
                return Next(message, sample, where, note, left_out, old.age)
        if skipped:
            raise trouble
        hint = f"It is published by {', '.join(stream.nodes)}." if stream.publishers else "It has no publisher."
        raise TimedOut(f"No message on {topic} ({source.words}).", hint)
