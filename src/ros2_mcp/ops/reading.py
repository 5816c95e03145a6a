"""Reading topics: collect samples for a while, then show as many as fit.

Samples stay bytes until it is known which of them are shown.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from time import monotonic
from typing import TYPE_CHECKING, Any

from ros2_mcp.guard.policy import bounded
from ros2_mcp.model.errors import BadInput, RobotError
from ros2_mcp.model.pictures import COMPRESSED_IMAGE, IMAGE, Picture
from ros2_mcp.model.samples import Sample
from ros2_mcp.ops.results import Report, WithPictures, facts, is_recorded, iso_time, silent

if TYPE_CHECKING:
    from ros2_mcp.codec.cdr import Codec
    from ros2_mcp.codec.definitions import Definitions
    from ros2_mcp.ops.window import Source, Stream

FIRST_MESSAGE_S = 5.0
LIMITED_S = 20.0
MAX_SAMPLES = 100_000
MAX_BYTES = 64_000_000
MAX_PICTURES = 4


@dataclass(frozen=True, slots=True)
class View:
    """How messages are shown: chosen fields, elements shown of long arrays, every n-th message, bytes of text."""

    fields: Sequence[str] = ()
    max_array: int = 64
    every_n: int = 1
    max_bytes: int = 32_000


@dataclass(frozen=True, slots=True)
class Request:
    """What to read: a topic, and when to stop. With neither limit: the first message, waiting at most 5 s."""

    topic_name: str
    topic_type: str = ""
    duration_s: float | None = None
    message_limit: int | None = None

    @property
    def longest_s(self) -> float:
        """How long reading takes at most."""
        if self.duration_s is not None:
            return self.duration_s
        return FIRST_MESSAGE_S if self.message_limit is None else LIMITED_S

    @property
    def enough(self) -> int | None:
        """After how many messages reading ends early; None is never."""
        if self.duration_s is None and self.message_limit is None:
            return 1
        return self.message_limit


@dataclass(frozen=True, slots=True)
class Reading(WithPictures):
    """The messages of one topic.

    `count` messages are shown, of `received` ones; `dropped` were discarded by this server's memory bounds, `lost`
    never arrived (null where that cannot be known). `truncated` names paths whose values are summaries. `source` says
    whether they are live, or of which part of which recording; `duration` is its length.
    """

    topic_name: str
    topic_type: str = ""
    messages: Sequence[dict[str, Any]] = ()
    received_at: Sequence[str] = ()
    count: int = 0
    duration: float = 0.0
    received: int = 0
    dropped: int = 0
    lost: int | None = None
    publishers: Sequence[str] = ()
    qos: str = ""
    truncated: Sequence[str] = ()
    note: str = ""
    error: str = ""
    source: str = ""

    def summary(self) -> str:
        """One line."""
        if self.error:
            return f"{self.topic_name}: {self.error}"
        shown = "" if self.count == self.received else f", {self.count} shown"
        where = self.source if is_recorded(self.source) else f"{self.duration:.2f} s"
        return f"{self.topic_name}: {self.received} message(s) in {where}{shown}. {self.note}".rstrip()


@dataclass(frozen=True, slots=True)
class Readings(WithPictures):
    """The messages of several topics, read at the same time; an `error` of one leaves the others."""

    topics: Sequence[Reading]
    duration: float

    def summary(self) -> str:
        """A line for each topic."""
        return "\n".join(reading.summary() for reading in self.topics)


@dataclass(frozen=True, slots=True)
class Echo(WithPictures):
    """The next message of a topic, or `received` false and the reason; `waited` is how long this took, in seconds."""

    topic_name: str
    topic_type: str
    received: bool
    message: dict[str, Any] | None
    received_at: str
    waited: float
    publishers: Sequence[str]
    truncated: Sequence[str]
    note: str
    source: str

    def summary(self) -> str:
        """One line."""
        what = "a message" if self.received else "no message"
        where = f"in {self.source}" if is_recorded(self.source) else f"after {self.waited:.2f} s"
        return f"{self.topic_name}: {what} {where}. {self.note}".rstrip()


@dataclass(slots=True)
class Collection:
    """Samples collected so far, bounded; the oldest are dropped and counted."""

    every_n: int
    samples: deque[Sample] = field(default_factory=deque[Sample])
    seen: int = 0
    kept_bytes: int = 0
    dropped: int = 0

    def add(self, samples: Sequence[Sample], enough: int | None) -> bool:
        """Takes samples in; true as soon as there are enough."""
        for sample in samples:
            self.seen += 1
            if (self.seen - 1) % self.every_n == 0:
                self._keep(sample)
            if enough is not None and len(self.samples) >= enough:
                return True
        return False

    def _keep(self, sample: Sample) -> None:
        self.samples.append(sample)
        self.kept_bytes += len(sample.data)
        while len(self.samples) > MAX_SAMPLES or (self.kept_bytes > MAX_BYTES and len(self.samples) > 1):
            self.kept_bytes -= len(self.samples.popleft().data)
            self.dropped += 1


async def read(source: Source, request: Request, view: View, report: Report = silent) -> Reading:
    """Messages of one topic, over the source's time.

    Raises:
        NotFound: if the topic is not there and its type is not given.
        TypeConflict: if it has several types, or another than the given one.
        BadValue: if a limit is out of range, or a field is not in the type.
    """
    _check_request(request, view)
    most = request.enough and request.enough * view.every_n
    async with source.follow(request.topic_name, request.topic_type, most=most) as stream:
        _check_fields(stream.codec.definitions, stream.type, view)
        collection = Collection(view.every_n)
        is_enough = await _collect(stream, collection, request, report)
        counts, covered_s = stream.counts(), stream.covered_s()
        last = collection.samples[-1] if collection.samples else None
        fewer = last is None or (request.enough is not None and not is_enough)
        note = await stream.why_no_more(last) if fewer else ""
    reading = await _show(stream, collection, view, note)
    return replace(
        reading,
        duration=round(covered_s, 6),
        received=collection.seen + counts.dropped,
        dropped=collection.dropped + counts.dropped,
        lost=counts.lost,
        source=source.words,
    )


async def read_several(sources: Sequence[tuple[Source, Request]], view: View, report: Report = silent) -> Readings:
    """Messages of several topics, truly at the same time."""
    if not sources:
        raise BadInput("No topics are given.", 'Give a list such as [{"name": "/odom", "duration": 2}].')
    started = monotonic()
    share = replace(view, max_bytes=max(view.max_bytes // len(sources), 1000))
    readings = await asyncio.gather(*(_read_or_error(source, request, share, report) for source, request in sources))
    images = [image for reading in readings for image in reading.images]
    return Readings(readings, monotonic() - started, pictures=facts(images), images=images)


async def _read_or_error(source: Source, request: Request, view: View, report: Report) -> Reading:
    try:
        return await read(source, request, view, report)
    except RobotError as error:
        return Reading(request.topic_name, error=str(error))


async def echo(source: Source, topic: str, topic_type: str, view: View) -> Echo:
    """The next message of a topic, waiting for the topic and for the message as long as the source lasts."""
    started = monotonic()
    reading = await read(source, Request(topic, topic_type, source.duration_s, 1), view)
    return Echo(
        reading.topic_name,
        reading.topic_type,
        received=bool(reading.messages),
        message=reading.messages[0] if reading.messages else None,
        received_at=reading.received_at[0] if reading.received_at else "",
        waited=round(monotonic() - started, 6),
        publishers=reading.publishers,
        truncated=reading.truncated,
        note=reading.note,
        source=reading.source,
        pictures=reading.pictures,
        images=reading.images,
    )


def _check_request(request: Request, view: View) -> None:
    bounded("every_n", view.every_n, 1, 1_000_000, "messages")
    if request.message_limit is not None:
        bounded("message_limit", request.message_limit, 1, MAX_SAMPLES, "messages")


def _check_fields(definitions: Definitions, type_name: str, view: View) -> None:
    if view.fields:
        from ros2_mcp.codec.select import parse_fields

        parse_fields(definitions, type_name, view.fields)


async def _collect(stream: Stream, collection: Collection, request: Request, report: Report) -> bool:
    """Takes samples in until there are enough; false if they ended before."""
    started = monotonic()
    async for batch in stream.batches:
        if collection.add(batch, request.enough):
            return True
        elapsed = monotonic() - started
        if elapsed > 1.0:
            await report(elapsed, max(request.longest_s, elapsed), f"{stream.topic}: {collection.seen} messages")
    return False


async def _show(stream: Stream, collection: Collection, view: View, note: str) -> Reading:
    samples = list(collection.samples)
    shown = await asyncio.to_thread(_render, stream.codec, stream.type, samples, view)
    images, problem = await asyncio.to_thread(_pictures, stream.codec, stream.type, shown.samples)
    omitted = len(samples) - len(shown.samples)
    thinned = f"{omitted} more are not shown, evenly left out: choose fields or every_n to see more." if omitted else ""
    return Reading(
        stream.topic,
        stream.type,
        shown.messages,
        [iso_time(sample.received_ns) for sample in shown.samples],
        count=len(shown.messages),
        publishers=stream.nodes,
        qos=stream.qos,
        truncated=shown.truncated,
        note=" ".join(filter(None, (note, thinned, shown.hint, problem))),
        pictures=facts(images),
        images=images,
    )


@dataclass(frozen=True, slots=True)
class _Shown:
    samples: Sequence[Sample] = ()
    messages: Sequence[dict[str, Any]] = ()
    truncated: Sequence[str] = ()
    hint: str = ""


def _render(codec: Codec, type_name: str, samples: Sequence[Sample], view: View) -> _Shown:
    """As many of the samples as fit, evenly spread, first and last included."""
    from ros2_mcp.codec.render import RenderOptions, render

    if not samples:
        return _Shown()

    def rendered(sample: Sample, max_bytes: int):
        options = RenderOptions(max_array=view.max_array, max_bytes=max_bytes, fields=tuple(view.fields) or None)
        return render(codec.definitions, type_name, codec.decode(type_name, sample.data), options=options)

    size = rendered(samples[-1], view.max_bytes).bytes + 60
    shown = spread(samples, max(view.max_bytes // size, 1))
    results = [rendered(sample, max(view.max_bytes // len(shown), 500)) for sample in shown]
    truncated = sorted({path for result in results for path in result.truncated})
    return _Shown(shown, [result.value for result in results], truncated, results[-1].hint)


def spread(samples: Sequence[Sample], most: int) -> list[Sample]:
    """At most `most` of the samples, evenly spread, the first and the last among them."""
    if len(samples) <= most:
        return list(samples)
    if most == 1:
        return [samples[-1]]
    step = (len(samples) - 1) / (most - 1)
    return [samples[round(index * step)] for index in range(most)]


def _pictures(codec: Codec, type_name: str, samples: Sequence[Sample]) -> tuple[list[Picture], str]:
    if type_name not in (IMAGE, COMPRESSED_IMAGE):
        return [], ""
    from ros2_mcp.codec.pictures import picture_of

    try:
        chosen = spread(samples, MAX_PICTURES)
        return [picture_of(type_name, codec.decode(type_name, sample.data)) for sample in chosen], ""
    except RobotError as error:
        return [], f"No picture: {error}"
