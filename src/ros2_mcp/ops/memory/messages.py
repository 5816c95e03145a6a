"""Messages of the past: the messages of a topic, from the first source that has some."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from contextlib import aclosing, suppress
from dataclasses import dataclass, field, replace
from typing import Any

from ros2_mcp.guard.policy import bounded
from ros2_mcp.model import names
from ros2_mcp.model.errors import BadData, BadName, BadValue, NotFound, RobotError
from ros2_mcp.model.meanings import Meaning
from ros2_mcp.model.text import counted
from ros2_mcp.model.values import summarised
from ros2_mcp.ops.memory.bag_store import BLACK_BOX, BagStore
from ros2_mcp.ops.results.results import IF_ANY, ON_REQUEST, SAID, Report, beside, iso_time, reporting, silent
from ros2_mcp.ops.sources.bag import end_note
from ros2_mcp.ops.sources.kinds import Sources
from ros2_mcp.ops.sources.selection import MAX_MESSAGES, Fitted, Selection, fit, message_times
from ros2_mcp.ops.sources.source import ANSWER_S, Source, SourceRequest
from ros2_mcp.ops.space.meaning import meaning_of_newest
from ros2_mcp.ops.topics.subscribe import Collected, collect

_ANY = "any"
"""Callers that know WiseVision's own tool give this if they mean no type."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredMessages:
    """Stored messages with the times at which they were stored (empty if the source does not give them).

    For a recording, `times_s` has the same times in seconds from `start`, its beginning (otherwise both are empty).
    `count` of the `found` messages are shown; `note` says if there are earlier ones that were not read. `truncated`
    lists the paths of shortened values. `meaning` interprets the newest message of a laser scan, a point cloud or a
    depth image, seen from the robot's base.
    """

    source: str = field(metadata=SAID)
    topic_name: str = field(metadata=SAID)
    topic_type: str
    timestamps: Sequence[str]
    start: str
    times_s: Sequence[float] = field(metadata=beside("messages"))
    messages: Sequence[dict[str, Any]]
    count: int = field(metadata=SAID)
    found: int = field(metadata=SAID)
    truncated: Sequence[str] = field(metadata={**IF_ANY, **SAID})
    note: str = field(metadata=IF_ANY)
    meaning: Meaning | None = field(default=None, metadata={**ON_REQUEST, **SAID})

    def summary(self) -> str:
        """Return the result in one line."""
        said = f"{self.note} {self.meaning or ''}".strip()
        return (
            f"{self.topic_name}: {self.count} of {counted(self.found, 'message')} from {self.source}. {said}".rstrip()
        )


@dataclass(frozen=True, slots=True)
class _Found:
    """The messages of a source, and the errors of the sources before it."""

    source: Source
    collected: Collected
    failed: Sequence[RobotError]


async def get_messages(
    sources: Sources,
    topic: str,
    type_name: str,
    request: SourceRequest,
    selection: Selection,
    report: Report = silent,
) -> StoredMessages:
    """Return the last messages in a time span of the past, from the first source that has some.

    The selection's `message_limit` is the number of messages (None: all). If they do not fit, they are evenly thinned.

    Raises:
        NotFound: if no source has the topic.
        BadValue: if a limit or a time is out of range, or a field is not in the type.
        BadData: if no message can be decoded as its type.
        RobotError: the error of a source that failed, if no other source has the messages.
    """
    bounded("number_of_messages", selection.message_limit or 0, 0, MAX_MESSAGES, "messages")
    selection.check()
    with suppress(BadName):  # a recording may have other names
        topic = names.absolute(topic)
    type_name = "" if type_name in ("", _ANY) else await sources.robot.types.full_name(type_name, "msg")
    async with reporting(report, ANSWER_S, f"looking for earlier messages of {topic}"):
        found = await _find(sources, topic, type_name, request, selection)
    samples = found.collected.samples[:: -selection.every_n][::-1]  # counted from the newest
    stream = found.collected.stream
    fitted = await asyncio.to_thread(fit, stream.codec, stream.type, samples, selection) if samples else Fitted()
    meaning = await meaning_of_newest(found.source, stream, fitted)
    return replace(_show(found, fitted, type_name, request, selection), meaning=meaning)


async def _find(sources: Sources, topic: str, type_name: str, request: SourceRequest, selection: Selection) -> _Found:
    """Return the messages of the first source that has some; if none has and none has failed, those of the
    first source that knows the topic.
    """
    filters = [path for path in selection.fields if "==" in path]
    all_of_them = replace(selection, fields=filters, every_n=1, message_limit=selection.message_limit or MAX_MESSAGES)
    empty: _Found | None = None
    failed: list[RobotError] = []
    async with aclosing(sources.of_the_past(request)) as opened:
        async for source in opened:
            try:
                if isinstance(source, RobotError):
                    raise source
                expected = "" if source.keeps_types else type_name
                collected = await collect(source, topic, expected, all_of_them, latched=False, names=request.names)
                if collected.samples:  # if it cannot be decoded, another source may have readable messages
                    collected.stream.codec.definitions.structure(collected.stream.type)
            except (BadName, BadValue):
                raise
            except NotFound:
                continue  # a bag that does not have the topic
            except RobotError as error:
                failed.append(error)
                continue
            found = _Found(source, collected, failed)
            if collected.samples:
                return found
            empty = empty or found
    if failed:  # the source that failed may have the messages
        raise failed[0]
    if empty:
        return empty
    raise NotFound(
        f"No messages of {topic} are stored: no Data Black Box, recording or opened bag has this topic.",
        _how_to_keep(sources.store),
    )


def _how_to_keep(store: BagStore) -> str:
    """Return a hint on how to keep messages of a topic for later."""
    more = "Record with ros2_record_start, or open a bag with ros2_bag_info."
    if BLACK_BOX not in store.own:
        return f"The option --black-box keeps the last hours of chosen topics. {more}"
    return f"The black box of this server does not keep this topic; choose its topics with --black-box. {more}"


def _show(
    found: _Found, fitted: Fitted, type_name: str, request: SourceRequest, selection: Selection
) -> StoredMessages:
    source, stream, samples = found.source.title, found.collected.stream, found.collected.samples
    if samples and not fitted.samples:
        raise BadData(
            f"{source} has {counted(len(samples), 'message')} of {stream.topic}, but none of type {stream.type}.",
            "Give the message_type with which they were stored; it is another type, or another version of this one.",
        )
    of_recording = found.source.began_ns is not None
    start, times_s = message_times(found.source, fitted.samples) if of_recording else ("", [])
    notes = [f"Another source failed: {error.message}" for error in found.failed]
    notes += [stream.note, stream.odd_times, end_note(found.source, request.start, request.end)]
    if len(samples) != selection.message_limit:  # a request for the last two needs no note that there are others
        notes.append(found.collected.more)
    if type_name not in ("", stream.type):
        notes.append(f"The messages are {stream.type}, not {type_name}.")
    if dropped := found.collected.dropped:
        notes.append(f"{counted(dropped, 'earlier message')} did not fit in memory.")
    notes += [fitted.note, summarised(fitted.truncated)]
    if not samples:
        notes.append("No message in that time." if request.start or request.end else "It has no message of this topic.")
    return StoredMessages(
        source=source,
        topic_name=stream.topic,
        topic_type=stream.type,
        timestamps=[iso_time(sample.received_ns) if sample.received_ns else "" for sample in fitted.samples],
        start=start,
        times_s=times_s,
        messages=fitted.values,
        count=len(fitted.values),
        found=len(samples),
        truncated=list(fitted.truncated),
        note=" ".join(filter(None, notes)),
    )
