"""The next message of a topic, for a picture of it."""

from __future__ import annotations

import asyncio
from typing import Any

from ros2_mcp.model import names
from ros2_mcp.model.errors import TimedOut, TypeConflict
from ros2_mcp.model.samples import Sample
from ros2_mcp.model.text import named
from ros2_mcp.ops.results import Report, reporting
from ros2_mcp.ops.sources.source import Source


async def next_message(source: Source, topic: str, type_name: str, report: Report) -> tuple[Any, Sample]:
    """The next message of a topic; of several that wait live, the newest.

    Raises:
        NotFound: if the topic is not there.
        TypeConflict: if it has another type.
        TimedOut: if no message came.
        BadData: if the message is not what its type says.
    """
    topic = names.absolute(topic)
    async with (
        reporting(report, source.duration_s, f"waiting for {topic}"),
        source.follow(topic, limit=1) as stream,
    ):
        if stream.type != type_name:
            raise TypeConflict(f"{topic} is a {named(stream.type)}, not a {type_name}.", "ros2_topic_list shows types.")
        async for batch in stream.batches:
            if batch:
                sample = batch[-1 if source.is_live else 0]
                return await asyncio.to_thread(stream.codec.decode, stream.type, sample.data), sample
        hint = f"It is published by {', '.join(stream.nodes)}." if stream.publishers else "Nobody publishes on it."
        raise TimedOut(f"No message on {topic} ({source.words}).", hint)
