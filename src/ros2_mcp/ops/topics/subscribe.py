"""Read the messages of topics, live or recorded, as `ros2 topic echo` does; `collect` serves bags and history, too.

Samples stay bytes until it is known which of them are shown: decoding costs most, and few of many are shown.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from time import monotonic
from typing import TYPE_CHECKING, Any

from ros2_mcp.model.aside import aside, load
from ros2_mcp.model.errors import BadData, BadInput, RobotError
from ros2_mcp.model.meanings import Meaning
from ros2_mcp.model.pictures import COMPRESSED_IMAGE, IMAGE, Picture
from ros2_mcp.model.samples import Sample
from ros2_mcp.model.text import counted, named
from ros2_mcp.model.times import seconds_from_start
from ros2_mcp.model.values import summarised
from ros2_mcp.ops.results.results import (
    ALWAYS,
    HIDDEN,
    IF_ANY,
    ON_REQUEST,
    SAID,
    Report,
    WithPictures,
    beside,
    exact_time,
    facts,
    iso_time,
    or_error,
    reporting,
    silent,
    unless_all_failed,
)
from ros2_mcp.ops.sources.from_before import from_before
from ros2_mcp.ops.sources.selection import (
    MAX_MESSAGES,
    Collector,
    Fitted,
    Selection,
    fit,
    message_times,
    spread_indices,
    undecodable,
)
from ros2_mcp.ops.space.meaning import meaning_of_newest

if TYPE_CHECKING:
    from ros2_mcp.ops.sources.source import Source, Stream

MAX_PICTURES = 4
"""The most pictures of one topic: clients count a picture as some 1500 tokens, and two usually show what moved."""
_TRIED = 32
"""How many messages of a recording are tried to find a message that can be decoded; undecodable messages are rare."""
_LEAST_BYTES = 1000
"""The least bytes of the result for one of several topics: two messages at the 500 bytes
below which a message says nothing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading(WithPictures):
    """The messages of one topic.

    `count` messages are shown, of `received` ones. `dropped` were discarded because this server's memory is limited, or
    the link to the robot was too slow; `lost` never arrived (null if unknown). `truncated` lists the paths of shortened
    values. `source` is "live", or names the recording and its part; `duration` is the length of that part, or how long
    the read took. `meaning` interprets the newest message of a laser scan, a point cloud or a depth image, seen from
    the robot's base. Each message was received `times_s` seconds after `start`: the start of the recording, or the
    first live message. `from_before` counts messages that had been published before this call (latched ones), and gives
    the age of the newest.
    """

    topic_name: str = field(metadata=SAID)
    topic_type: str = ""
    messages: Sequence[dict[str, Any]] = field(default=(), metadata=ALWAYS)
    start: str = ""
    times_s: Sequence[float] = field(default=(), metadata=beside("messages"))
    count: int = field(default=0, metadata=SAID)
    duration: float = 0.0
    received: int = field(default=0, metadata=SAID)
    dropped: int = 0
    lost: int | None = None
    publishers: Sequence[str] = ()
    qos: str = ""
    from_before: str = field(default="", metadata=SAID)
    truncated: Sequence[str] = field(default=(), metadata=SAID)
    note: str = ""
    error: str = ""
    source: str = field(default="", metadata=SAID)
    meaning: Meaning | None = field(default=None, metadata={**ON_REQUEST, **SAID})
    is_live: bool = field(default=True, metadata=HIDDEN)
    received_ns: Sequence[int] = field(default=(), metadata=HIDDEN)

    def summary(self) -> str:
        """Return the result in one line."""
        if self.error:
            return f"{self.topic_name}: {self.error}"
        shown = "" if self.count == self.received else f", {self.count} shown"
        where = "" if self.is_live else "in "
        said = f"{self.note} {self.meaning or ''}".strip()
        apart = "," if self.from_before.endswith(self.source) and self.from_before else ""  # all are from before
        count = f"{counted(self.received, 'message')}{apart}"
        return f"{self.topic_name}: {count} {where}{self.source}{shown}. {said}".rstrip()


@dataclass(frozen=True, slots=True)
class Readings(WithPictures):
    """The messages of several topics, read at the same time; each topic may have its own `error`."""

    topics: Sequence[Reading]
    duration: float

    def summary(self) -> list[str]:
        """Return a line for each topic."""
        return [reading.summary() for reading in self.topics]


@dataclass(frozen=True, slots=True, kw_only=True)
class Echo(WithPictures):
    """The next message of a topic; `received` is false if there was none, and `note` says why. `waited` is the waiting
    time in seconds.

    `seconds_from_start` is the receive time as an offset from the start of the recording; null for live messages and
    the black box. `from_before` is set if the message had been published before this call, and gives its age.
    """

    topic_name: str = field(metadata=SAID)
    topic_type: str
    received: bool = field(metadata=SAID)
    message: dict[str, Any] | None
    received_at: str
    seconds_from_start: float | None
    waited: float = field(metadata=SAID)
    publishers: Sequence[str]
    truncated: Sequence[str] = field(metadata={**IF_ANY, **SAID})
    note: str = field(metadata=IF_ANY)
    from_before: str = field(metadata=SAID)
    source: str = field(metadata=SAID)
    meaning: Meaning | None = field(default=None, metadata={**ON_REQUEST, **SAID})
    is_live: bool = field(metadata=HIDDEN)

    def summary(self) -> str:
        """Return the result in one line."""
        what = "a message" if self.received else "no message"
        where = f"after {self.waited:.2f} s" if self.is_live else f"in {self.source}"
        if self.from_before:
            what, where = "", self.from_before
        said = f"{self.note} {self.meaning or ''}".strip()
        return f"{self.topic_name}: {f'{what} {where}'.lstrip()}. {said}".rstrip()


@dataclass(frozen=True, slots=True, kw_only=True)
class Collected:
    """The messages read from a topic, still as bytes.

    `received` counts all messages that came; `dropped` of them are not among the samples because of memory bounds, or
    because a link was too slow (see the sentence `left_behind`). `more` is a sentence on how to read on if there are
    more; `why_no_more` says why fewer came than requested.
    """

    stream: Stream
    samples: Sequence[Sample]
    received: int
    dropped: int
    lost: int | None
    covered_s: float
    why_no_more: str
    more: str
    left_behind: str


async def collect(
    source: Source,
    topic: str,
    type_name: str,
    selection: Selection,
    report: Report = silent,
    *,
    latched: bool = True,
    names: tuple[str, str] = ("start", "end"),
) -> Collected:
    """Return the samples of one topic that the selection asks for; `names` are the
    arguments by which a caller reads on.

    Raises:
        NotFound: if the topic does not exist and its type is not given.
        TypeConflict: if the topic has several types, or another than the given one.
        BadValue: if a limit is out of range, or a field is not in the type.
    """
    selection.check()
    limit, every_n, filtered = selection.enough, selection.every_n, selection.has_filter
    if limit == 1 and not filtered:
        source = source.judging()  # the bridge omits all replayed messages but the newest
    # A source cannot count what passes a filter: it gives all, and the first or last ones are kept here.
    asked, asked_n = (None, 1) if filtered else (limit, every_n)
    async with source.follow(topic, type_name, limit=asked, every_n=asked_n, latched=latched) as stream:
        if stream.type:
            selection, lacking = selection.fitting(stream.codec.definitions, stream.type)
            stream.note = f"{stream.note} {lacking}".strip()
        collector = Collector(every_n=1 if stream.thinned else every_n, enough=limit)
        if filtered and source.from_end:
            collector = Collector(every_n=every_n, max_samples=limit or MAX_MESSAGES)
        is_full, others, kept = False, 0, _Kept(stream, limit if source.is_live and every_n == 1 else None)
        async with reporting(report, source.duration_s, lambda: f"{stream.topic}: {collector.seen} messages"):
            async for batch in stream.batches:
                if filtered:
                    passed = await asyncio.to_thread(selection.wanted, stream.codec, stream.type, batch)
                    others += len(batch) - len(passed)
                    batch = passed  # noqa: PLW2901
                if is_full := collector.add(kept.let_through(batch)):
                    break
            is_full = is_full or collector.add(kept.remaining())
        samples = list(collector.samples)
        counts, further = stream.counts, stream.further
        if kept.left_out:
            older = counted(kept.left_out, "older message")
            stream.note = f"{stream.note} Not shown: {older} published before this call.".lstrip()
        if others:
            stream.note = f"{stream.note} No such element in {counted(others, 'other message')}.".lstrip()
        was_limited = filtered and not source.is_live and len(samples) == limit
        dropped = 0 if filtered and len(samples) == limit else collector.dropped
        ended_early = not samples or (limit is not None and not (is_full or was_limited) and further is None)
        more = ""
        if was_limited and not source.from_end:
            after = exact_time(samples[-1].received_ns + 1)
            more = f"There may be later messages: to read them, give {names[0]} {after}."
        elif (was_limited and collector.dropped) or (further and stream.from_end):
            before = exact_time(samples[0].received_ns - 1)
            more = f"There are earlier messages: to read them, give {names[1]} {before}."
        elif further:
            more = f"There are later messages: to read them, give {names[0]} {exact_time(further.received_ns)}."
        # Thinned-out messages are counted in the bridge; its count also has those that were dropped.
        received = counts.received if stream.thinned else collector.seen
        received += 0 if stream.thinned and source.is_live else counts.dropped
        return Collected(
            stream=stream,
            samples=samples,
            received=received,
            dropped=dropped + counts.dropped,
            lost=counts.lost,
            covered_s=stream.covered_s,
            why_no_more=await stream.why_no_more(samples[-1] if samples else None) if ended_early else "",
            more=more,
            left_behind=stream.left_behind,
        )


class _Kept:
    """Holds back the replayed messages of a latched topic, the oldest of which come first, until the newest have come:
    a request for `limit` messages means the newest. With `limit` None nothing is held back.
    """

    def __init__(self, stream: Stream, limit: int | None) -> None:
        self._stream = stream
        self._held: deque[Sample] | None = None if limit is None else deque(maxlen=limit)
        self.left_out = 0

    def let_through(self, batch: Sequence[Sample]) -> Sequence[Sample]:
        """Return the samples to pass on now; an empty batch means that no message came for a while."""
        if self._held is None:
            return batch
        for number, sample in enumerate(batch):
            if not self._stream.is_replayed(sample):
                return [*self.remaining(), *batch[number:]]
            self.left_out += len(self._held) == self._held.maxlen
            self._held.append(sample)
        return self.remaining() if self._held and not batch else ()

    def remaining(self) -> Sequence[Sample]:
        """Return the samples that are still held back, and hold back nothing from now on."""
        held, self._held = self._held or (), None
        return list(held)


async def read(source: Source, topic: str, type_name: str, selection: Selection, report: Report = silent) -> Reading:
    """Return messages of one topic, for as long as the selection says. Raises the same errors as `collect`.

    Over a network, compressed pictures are read, unless a type or fields are given.
    """
    source = source.lasting(selection.live_s, recorded_s=selection.duration_s)
    chosen = topic if type_name or selection.fields else await source.lightest(topic)
    collected = await collect(source, chosen, type_name, selection, report)
    return _told(await _shown(source, collected, selection), as_asked=chosen == topic)


async def read_several(
    source: Source, topics: Sequence[tuple[str, str, Selection]], report: Report = silent
) -> Readings:
    """Return messages of several topics (name, type or "", selection), read at the same time; the `error` of one topic
    does not stop the others.

    Raises:
        BadInput: if there are no topics.
        AllFailed: if none could be read.
    """
    if not topics:
        raise BadInput("No topics are given.", 'Give a list such as [{"name": "/odom", "duration": 2}].')

    def share(selection: Selection) -> Selection:
        return replace(selection, max_bytes=max(selection.max_bytes // len(topics), _LEAST_BYTES))

    started = monotonic()
    reads = [
        or_error(read(source, topic, kind, share(selection), report), partial(Reading, topic_name=topic))
        for topic, kind, selection in topics
    ]
    readings = unless_all_failed(await asyncio.gather(*reads))
    images = [image for reading in readings for image in reading.images]
    return Readings(readings, monotonic() - started, pictures=facts(images), images=images)


async def echo(source: Source, topic: str, topic_type: str, selection: Selection) -> Echo:
    """Return the next message of a topic, waiting for the topic and for the message as long as the source lasts; of the
    messages that a latched topic replays, the newest.
    """
    started, source = monotonic(), source.judging()
    selection = replace(selection, message_limit=1)
    chosen = topic if topic_type or selection.fields else await source.lightest(topic)
    collected = await collect(source, chosen, topic_type, selection)
    reading = _told(await _shown(source, collected, selection), as_asked=chosen == topic)
    if collected.samples and not reading.messages and not source.is_live:  # then the next message that can be decoded
        several = await collect(source, topic, topic_type, replace(selection, message_limit=_TRIED))
        found, note = await asyncio.to_thread(_first_readable, several)
        if found:
            reading = await _shown(source, replace(several, samples=[found], more=""), selection)
            reading = replace(reading, note=f"{note} {reading.note}".rstrip())
    return Echo(
        topic_name=reading.topic_name,
        topic_type=reading.topic_type,
        received=bool(reading.messages),
        message=reading.messages[0] if reading.messages else None,
        received_at=iso_time(reading.received_ns[0]) if reading.received_ns else "",
        seconds_from_start=seconds_from_start(reading.received_ns[0], source.began_ns) if reading.received_ns else None,
        waited=round(monotonic() - started, 6),
        publishers=reading.publishers,
        truncated=reading.truncated,
        note=reading.note,
        from_before=reading.from_before,
        source=reading.source,
        meaning=reading.meaning,
        is_live=source.is_live,
        pictures=reading.pictures,
        images=reading.images,
    )


def _told(reading: Reading, *, as_asked: bool) -> Reading:
    """Return the reading, with a note if another topic was read than the requested topic."""
    if as_asked:
        return reading
    why = f"The robot is reached over a network, so the compressed pictures on {named(reading.topic_name)} were read."
    note = f"{why} {reading.note}"
    return replace(reading, note=note.rstrip())


def _first_readable(collected: Collected) -> tuple[Sample | None, str]:
    """Return the first sample that can be decoded (the last, if the last messages were requested), and a note on the
    skipped samples.
    """
    stream, trouble = collected.stream, ""
    ordered = collected.samples[::-1] if stream.from_end else collected.samples
    for skipped, sample in enumerate(ordered):
        try:
            stream.codec.decode(stream.type, sample.data)
        except BadData as error:
            trouble = trouble or str(error)
            continue
        return sample, undecodable(skipped, trouble)
    return None, ""


async def _shown(source: Source, collected: Collected, selection: Selection) -> Reading:
    stream = collected.stream
    if stream.type:
        selection, _ = selection.fitting(stream.codec.definitions, stream.type)
    await load("ros2_mcp.values.cdr")  # with numpy: not before it is needed
    size = sum(len(sample.data) for sample in collected.samples)
    fitted = await aside(size, fit, stream.codec, stream.type, collected.samples, selection)
    images: list[Picture] = []
    said = ""
    if stream.type in (IMAGE, COMPRESSED_IMAGE):
        images, said = await asyncio.to_thread(pictures_of, stream.type, fitted)
    start, times_s = message_times(source, fitted.samples)
    # With the picture, a hint on how to read its bytes is not needed.
    hint = summarised({path: by for path, by in fitted.truncated.items() if not images or path != "data"})
    # Fewer than requested although there are more: they were too many to keep.
    cut = collected.more if len(collected.samples) < (selection.enough or 0) else ""
    if collected.dropped and collected.samples and not collected.left_behind:
        since = exact_time(collected.samples[0].received_ns)
        count = len(collected.samples)
        kept = f"Only the newest {count} messages, from {since} on, were kept; earlier ones did not fit in memory."
        cut = f"{kept} {cut}".rstrip()
    old = from_before(source, stream, collected.samples)
    notes = (
        stream.mixed,
        stream.note,
        stream.odd_times,
        collected.left_behind,
        collected.why_no_more,
        cut,
        fitted.note,
        hint,
        said,
    )
    return Reading(
        topic_name=stream.topic,
        topic_type=stream.type,
        messages=fitted.values,
        start=start,
        times_s=times_s,
        count=len(fitted.values),
        duration=round(collected.covered_s, 6),
        received=collected.received,
        dropped=collected.dropped,
        lost=collected.lost,
        publishers=stream.nodes,
        qos=stream.qos,
        truncated=list(fitted.truncated),
        note=" ".join(filter(None, notes)),
        from_before=str(old),
        source=old.beside(source.words_after(collected.covered_s)),
        meaning=await meaning_of_newest(source, stream, fitted),
        is_live=source.is_live,
        received_ns=[sample.received_ns for sample in fitted.samples],
        pictures=facts(images),
        images=images,
    )


def pictures_of(type_name: str, fitted: Fitted) -> tuple[list[Picture], str]:
    """Return pictures of the shown messages, from the decoded messages, and a note on which messages they show, or why
    there are no pictures.
    """
    from ros2_mcp.pictures.messages import picture_of  # numpy: not at the start of the server

    try:
        chosen = spread_indices(len(fitted.messages), MAX_PICTURES)
        images = [picture_of(type_name, fitted.messages[index]) for index in chosen]
    except RobotError as error:
        return [], f"No picture: {error}"
    if len(chosen) == len(fitted.messages):
        return images, ""
    which = ", ".join(str(index + 1) for index in chosen)
    return images, (
        f"Pictures of {len(chosen)} of the {len(fitted.messages)} messages are shown (numbers {which}). For a picture "
        f"of each, give a message_limit of at most {MAX_PICTURES}."
    )
