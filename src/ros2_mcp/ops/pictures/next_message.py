"""The next message of a topic, for a picture of it."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import Any

from ros2_mcp.model import names
from ros2_mcp.model.errors import BadData, TimedOut, TypeConflict
from ros2_mcp.model.samples import Sample
from ros2_mcp.model.text import named
from ros2_mcp.ops.results import Report, reporting
from ros2_mcp.ops.sources.selection import undecodable
from ros2_mcp.ops.sources.source import Source

_TRIED = 32
"""Messages of a recording among which the first that can be decoded is looked for; one that cannot is rare."""


@dataclass(frozen=True, slots=True)
class Next:
    """A message with its sample; `note` says how many were skipped because they are not what their type says."""

    message: Any
    sample: Sample
    note: str


async def next_message(source: Source, topic: str, type_name: str, report: Report) -> Next:
    """The next message of a topic that can be decoded; of several that wait live, the newest.

    Raises:
        NotFound: if the topic is not there.
        TypeConflict: if it has another type.
        TimedOut: if no message came.
        BadData: if no message is what the type says.
    """
    topic = names.absolute(topic)
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
            # live, and of a recording without a start, the newest comes first
            for sample in batch[::-1] if source.is_live or stream.from_end else batch:
                try:
                    message = await asyncio.to_thread(stream.codec.decode, stream.type, sample.data)
                except BadData as error:
                    skipped, trouble = skipped + 1, error
                    continue
                return Next(message, sample, undecodable(skipped, str(trouble)) if skipped else "")
        if skipped:
            raise trouble
        hint = f"It is published by {', '.join(stream.nodes)}." if stream.publishers else "Nobody publishes on it."
        raise TimedOut(f"No message on {topic} ({source.words}).", hint)
