"""A bag as a source of samples: the same operations measure the robot and its recording, even while it is recorded."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Awaitable, Callable, Iterable, Iterator, Sequence
from contextlib import aclosing, asynccontextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain, islice
from typing import TYPE_CHECKING, Generic

from ros2_mcp.bags.contents import why_unreadable
from ros2_mcp.bags.schema import definitions_in, schema_text
from ros2_mcp.bags.stored import Span, StoredTopic, joined
from ros2_mcp.model import names
from ros2_mcp.model.errors import (
    BadInput,
    BadValue,
    LinkError,
    NotFound,
    RobotError,
    TypeConflict,
    UnknownInterface,
)
from ros2_mcp.model.interfaces import DefinitionText
from ros2_mcp.model.qos import Endpoint, QoS
from ros2_mcp.model.samples import Sample
from ros2_mcp.model.text import named
from ros2_mcp.model.times import recorded_time
from ros2_mcp.ops.memory.bag_store import BLACK_BOX, BagStore, OpenedBag
from ros2_mcp.ops.results.results import Report, iso_time, silent
from ros2_mcp.ops.sources import older_types
from ros2_mcp.ops.sources.selection import MAX_BYTES
from ros2_mcp.ops.sources.source import (
    Capture,
    GraphSnapshot,
    K,
    Keep,
    Missing,
    Source,
    SourceKind,
    SourceRequest,
    Stream,
    captured,
)
from ros2_mcp.ops.sources.times import is_relative, span_of
from ros2_mcp.robot import Robot, TopicEndpoints

if TYPE_CHECKING:
    from ros2_mcp.bags.bag import Bag
    from ros2_mcp.values.cdr import Codec
    from ros2_mcp.values.definitions import Definitions

_BATCH = 256
_BATCH_BYTES = 8_000_000
"""The size of a batch, read in another thread: large enough to start rarely, small enough to be cancelled soon."""
_WAITING_BYTES = 100_000
"""Bytes of one topic that are collected before its messages are passed on together; for 60 topics these are 6 MB."""
_TO_DISK_NS = 1_000_000_000
"""Messages that are being recorded reach the disk up to a second after their receipt (`recorder.FLUSH_S`)."""
_JSON_LOOKED_AT = 20_000
"""Messages from the beginning from which the fields of a JSON type are learnt, and a tenth as many from the end: all
messages of a log of events, and reading so many takes half a second."""
_RECORDED = "(recorded)"


@dataclass(kw_only=True)
class _BagStream(Stream):
    """A topic of a bag that also reports unreadable parts. `bag` is the bag that it reads, once it has begun.

    If the files change meanwhile, others open the bag again, and do not know what is found here.
    """

    bag: Bag | None = None
    odd: str = ""

    @property
    def odd_times(self) -> str:
        return self.odd

    def look_at_times(self, bag: Bag) -> None:
        """Note irregular times of the topic, as far as it has been read."""
        odd = bag.odd_times().get(self.topic)
        self.odd = odd.words if odd else ""

    @property
    def holes(self) -> Sequence[tuple[int, int]]:
        bag, topics = self.bag, (self.topic,)
        return joined(hole for hole in bag.holes if hole.touches(topics, self.start_ns, self.until_ns)) if bag else ()


@dataclass
class _Part(Generic[K]):
    """The kept data of one of several topics that are read together, and the number of its messages."""

    stored: StoredTopic
    stream: _BagStream
    kept: K
    received: int = 0
    _waiting: list[Sample] = field(default_factory=list[Sample])
    _bytes: int = 0

    def add(self, samples: Sequence[Sample]) -> None:
        """Add messages. They are passed on in batches: passed one by one, arrays would cost more than decoding."""
        self.received += len(samples)
        self._waiting += samples
        self._bytes += sum(len(sample.data) for sample in samples)
        if len(self._waiting) >= _BATCH or self._bytes >= _WAITING_BYTES:
            self.flush()

    def flush(self) -> None:
        """Pass on the collected messages."""
        if self._waiting:
            self.kept.add(self._waiting)
        self._waiting, self._bytes = [], 0


@dataclass(kw_only=True)
class BagSource(Source):
    """A part of a bag; created by `open_bag`. `covers` is the beginning and the end of the whole bag (Unix times, ns).

    With `from_end`, a limit means the last messages. `is_ring`: its beginning moves while it is recorded.
    `begins_later`: the recording begins after the requested start.
    """

    opened: OpenedBag
    span: Span
    name: str
    title: str
    covers: tuple[int, int]
    robot: Robot | None
    from_end: bool
    is_growing: bool = False
    is_ring: bool = False
    begins_later: bool = False

    def __post_init__(self) -> None:
        self.duration_s = (self.span.end_ns - self.span.start_ns) / 1e9
        # The beginning of a black box moves: seconds after it mean another time a minute later.
        self.began_ns = None if self.is_ring else self.covers[0]
        from_on = f"from {recorded_time(self.span.start_ns, self.began_ns)} on"
        growing = ", still being recorded" if self.is_growing and not self.is_ring else ""
        later = " (the recording begins after start)" if self.begins_later else ""
        self.words = f"bag {named(self.name)}{growing}, {self.duration_s:.4g} s {from_on}{later}"
        self._codec = self.opened.codec  # kept even if the bag's definitions change while it is read

    @property
    def codec(self) -> Codec:
        """The codec for its samples, with the definitions of the bag."""
        return self._codec

    def lasting(self, live_s: float, *, recorded_s: float | None = None, whole: bool = False) -> BagSource:  # noqa: ARG002
        """Return this part; if it is longer than `recorded_s`, its beginning (or its end, if no start was given)."""
        if recorded_s is None:
            return self
        longest_ns = max(round(recorded_s * 1e9), 1)
        start_ns = max(self.span.start_ns, self.span.end_ns - longest_ns) if self.from_end else self.span.start_ns
        end_ns = min(self.span.end_ns, start_ns + longest_ns)
        return replace(self, span=replace(self.span, start_ns=start_ns, end_ns=end_ns))

    @property
    def covers_ns(self) -> tuple[int, int]:
        """The Unix times (ns) between which this part was received."""
        return self.span.start_ns, self.span.end_ns

    def part(self, start_ns: int, end_ns: int) -> BagSource:
        """Return the samples received between two times (Unix times, ns), as a source."""
        start_ns, end_ns = max(self.span.start_ns, start_ns), min(self.span.end_ns, end_ns)
        return replace(self, span=replace(self.span, start_ns=start_ns, end_ns=max(start_ns, end_ns)))

    def from_beginning(self) -> BagSource:
        """Return the same part, extended to the beginning of the whole bag."""
        return replace(self, span=replace(self.span, start_ns=min(self.covers[0], self.span.start_ns)))

    async def name_of(self, topic: str) -> str:
        """Return the name of a topic as it is in the bag; an unknown name is returned, without surrounding spaces."""

        def find() -> str:
            with self.opened.reading() as bag:
                return find_topic(bag, topic).name

        try:
            return await asyncio.to_thread(find)
        except NotFound:
            return topic.strip()

    async def type_of(self, topic: str) -> str:
        """Return the type of a topic. Raises the same errors as `Source.type_of`."""
        return (await self._learn(topic)).type

    @asynccontextmanager
    async def follow(
        self,
        topic: str,
        type_name: str = "",
        *,
        limit: int | None = None,
        every_n: int = 1,
        latched: bool = True,
        times_only: bool = False,  # noqa: ARG002 - as in `captures`
    ) -> AsyncGenerator[Stream, None]:
        """Read every sample of a topic in order. Raises the same errors as `Source.follow`."""
        stored = await self._learn(topic)
        if type_name and not names.is_type(type_name, stored.type):
            raise TypeConflict(
                f"{stored.name} has the type {named(stored.type)}, not {type_name}.", "Leave out the type."
            )
        stream = self._stream(stored, limited=limit is not None)
        stream.batches = self._batches(stream, stored, limit, every_n, latched)
        async with aclosing(stream.batches):
            yield stream

    async def captures(
        self,
        topics: Sequence[str],
        keep: Keep[K],
        report: Report = silent,
        *,
        times_only: bool = False,  # noqa: ARG002 - reading the bytes is what finds damage
    ) -> Sequence[Capture[K] | Missing]:
        """Read all topics in one pass through a bag of any size: only what `keep` makes of the messages is kept."""
        found: list[_Part[K] | Missing] = []
        for topic in topics:
            try:
                stored = await self._learn(topic)
                stream = self._stream(stored, limited=False)
                found.append(_Part(stored, stream, keep(stream)))
            except RobotError as error:
                found.append(Missing(topic, error))
        parts = [part for part in found if isinstance(part, _Part)]
        wanted = replace(self.span, topics=frozenset(part.stored.name for part in parts))

        def begin() -> Iterator[tuple[str, Sample]]:
            with self.opened.reading() as bag:
                for part in parts:
                    part.stream.bag = bag
                    part.add(latched_before(bag, part.stored, replace(self.span, topics=(part.stored.name,))))
                return bag.messages(wanted)

        def further() -> int | None:
            """Read a batch. Return the time that it has reached, None at the end."""
            with self.opened.lock:
                batch = _batch(messages)
            for part in parts:
                part.add([sample for topic, sample in batch if topic == part.stored.name])
                if not batch:
                    part.flush()
            return batch[-1][1].received_ns if batch else None

        def look_at_times() -> None:
            with self.opened.lock:
                for part in parts:
                    if part.stream.bag:
                        part.stream.look_at_times(part.stream.bag)

        messages = await asyncio.to_thread(begin)
        while (reached_ns := await asyncio.to_thread(further)) is not None:
            done_s = (reached_ns - self.span.start_ns) / 1e9
            await report(done_s, self.duration_s, f"read {done_s:.0f} of {self.duration_s:.0f} s")
        await asyncio.to_thread(look_at_times)
        return [captured(self, one.stream, one.kept, one.received) if isinstance(one, _Part) else one for one in found]

    def _stream(self, stored: StoredTopic, *, limited: bool) -> _BagStream:
        publishers = _publishers(stored)
        return _BagStream(
            topic=stored.name,
            type=stored.type,
            codec=self._codec,
            note=older_types.told(self.opened, stored.type),
            publishers=publishers,
            qos=f"{publishers[0].qos.durability}, as it was recorded",
            start_ns=self.span.start_ns,
            until_ns=self.span.end_ns,
            from_end=limited and self.from_end,
            thinned=limited,
        )

    async def graph(self) -> GraphSnapshot:
        """Return the topics with the QoS of their publishers. A bag has no nodes and services."""

        def read() -> dict[str, TopicEndpoints]:
            with self.opened.reading() as bag:
                return {topic.name: TopicEndpoints(topic.name, _publishers(topic), ()) for topic in bag.topics.values()}

        return GraphSnapshot(await asyncio.to_thread(read))

    async def _learn(self, name: str) -> StoredTopic:
        def find() -> StoredTopic:
            with self.opened.reading() as bag:
                return find_topic(bag, name)

        topic = await asyncio.to_thread(find)
        if topic.form == "json":
            if not self._codec.knows_json(topic.type):
                await asyncio.to_thread(self._learn_json, topic.type)
        elif topic.form == "other":
            self._codec.definitions.refuse(topic.type, UnknownInterface(*why_unreadable(topic)))
        # Another topic of the bag may have brought another definition of the type, or of one that it contains.
        elif topic.definition or not self._codec.definitions.knows(topic.type):
            await learn(self._codec.definitions, topic, self.robot)
            if not topic.definition:
                await asyncio.to_thread(older_types.take, self.opened, self._codec, topic)
        return topic

    def _learn_json(self, type_name: str) -> None:
        """Learn the fields of a JSON type from messages of all its topics."""
        from ros2_mcp.values.json_messages import shape_of

        with self.opened.reading() as bag:
            topics = [topic for topic in bag.topics.values() if topic.type == type_name]
            span = Span(frozenset(topic.name for topic in topics))
            first = islice(bag.messages(span), _JSON_LOOKED_AT)
            last = islice(bag.messages(span, newest_first=True), _JSON_LOOKED_AT // 10)
            schema = next((topic.definition for topic in topics if topic.definition), "")
            shape = shape_of(schema, (sample.data for _, sample in chain(first, last)))
        self._codec.learn_json(type_name, shape)

    async def _batches(
        self, stream: _BagStream, stored: StoredTopic, limit: int | None, every_n: int, latched: bool
    ) -> AsyncGenerator[Sequence[Sample], None]:
        """Yield the samples of the bag as it is at the beginning, although it may grow meanwhile."""
        span = replace(self.span, topics=(stored.name,))

        def begin() -> Iterator[tuple[str, Sample]]:
            with self.opened.reading() as bag:
                stream.bag = bag
                before = [(stored.name, one) for one in latched_before(bag, stored, span)] if latched else []
                messages = bag.messages(span, newest_first=stream.from_end)
                ordered = chain(messages, before[::-1]) if stream.from_end else chain(before, messages)
                stream.look_at_times(bag)
                if limit is None:
                    return ordered
                # All at once: the thinned and limited samples fit into memory, and the newest first cannot be streamed.
                found, stream.received, stream.further = _taken((sample for _, sample in ordered), limit, every_n)
                return ((stored.name, sample) for sample in (found[::-1] if stream.from_end else found))

        def following() -> list[Sample]:
            with self.opened.lock:
                return [sample for _, sample in _batch(samples)]

        samples = await asyncio.to_thread(begin)
        while batch := await asyncio.to_thread(following):
            stream.received += 0 if stream.thinned else len(batch)
            yield batch


# ── finding and opening ──────────────────────────────────────────────────────────────────────────────────────────────


async def open_bag(
    store: BagStore,
    bag: str,
    start: str = "",
    end: str = "",
    robot: Robot | None = None,
    *,
    title: str = "",
    may_be_empty: bool = False,
    from_end: bool = False,
    names: tuple[str, str] = ("start", "end"),
) -> BagSource:
    """Open a bag, or the part of it between two times (as `times.span_of` reads them), as a `Source`.

    Without a start, or with `from_end`, a limit means the last messages. `names` are the caller's two arguments.

    Raises:
        NotFound: if there is no such bag.
        BadData: if nothing of it can be read.
        BadValue: if a time cannot be understood, or (unless it `may_be_empty`) nothing was recorded in that time.
    """

    def opened() -> BagSource:
        opened = store.opened(bag)
        with opened.reading() as found:
            first_ns, last_ns = times_of(store, found)
            is_growing = store.is_growing(found)
            asked = span_of(start, end, first_ns, last_ns, names)
        start_ns, end_ns = max(asked.start_ns, first_ns), min(asked.end_ns, last_ns + 1)
        if end_ns <= start_ns:
            if not may_be_empty:
                covers = f"It covers {iso_time(first_ns)} to {recorded_time(last_ns, first_ns)}."
                raise BadValue(names[0 if start else 1], f"{named(bag)} has no messages in that time.", covers)
            end_ns = start_ns
        return BagSource(
            opened=opened,
            span=Span(None, start_ns, end_ns),
            name=bag,
            title=title or f"the bag {named(bag)}",
            covers=(first_ns, last_ns),
            robot=robot,
            from_end=from_end or not start.strip(),
            is_growing=is_growing,
            is_ring=is_growing and found.path.name == BLACK_BOX,
            begins_later=bool(start.strip()) and not is_relative(start) and asked.start_ns < first_ns // 1000 * 1000,
        )

    return await asyncio.to_thread(opened)


class Bags(SourceKind):
    """The bags of this server as a kind of source: its own recordings, its black box among them, and all others."""

    async def named(self, robot: Robot, store: BagStore, request: SourceRequest) -> Source | None:
        """Return the bag of that name, else the recording that stands for the robot, else, for times, the black box."""
        name = request.name or store.subject_name
        if not name and (request.start or request.end):
            if BLACK_BOX not in store.own:
                hint = f"Name the recording with bag. {await asyncio.to_thread(store.which)}"
                asked = " and ".join(request.names)
                raise BadInput(f"{asked} needs a recording, but no recording is named.", hint)
            name = BLACK_BOX
        if not name:
            return None
        return await open_bag(store, name, request.start, request.end, robot, names=request.names)

    async def kept(
        self, robot: Robot, store: BagStore, request: SourceRequest
    ) -> Sequence[Callable[[], Awaitable[Source]]]:
        """Return functions that open this server's recordings, the robot's recording, and opened bags, newest first.

        The black box comes first while it is recorded. Recordings of former servers are not included.
        """
        own = dict(store.own)
        running = [name for name in own if name == BLACK_BOX and own[name].is_growing()]
        subject = [store.subject_name] if store.subject else []
        candidates = dict.fromkeys([*running, *reversed(own), *subject, *store.opened_names()])

        def opening(name: str) -> Callable[[], Awaitable[Source]]:
            title = f"this server's recording {named(name)}" if name in own else f"the bag {named(name)}"
            return partial(
                open_bag,
                store,
                name,
                request.start,
                request.end,
                robot,
                title=title,
                may_be_empty=True,
                from_end=True,
                names=request.names,
            )

        return [opening(name) for name in candidates]


async def learn(definitions: Definitions, topic: StoredTopic, robot: Robot | None) -> None:
    """Learn the definition of a topic's type and the types in it. An unknown one is noted as an error, raised when
    values are requested; times and sizes can still be measured.
    """
    try:
        definitions.add(await definitions_of(topic, robot))
        asked: set[str] = set()
        while lacking := definitions.unknown_in(topic.type):  # some writers leave out what a definition refers to
            name = lacking[0]
            if name in asked:
                raise UnknownInterface(f"{named(topic.type)} contains {named(name)}, whose definition is not known.")
            asked.add(name)
            found = await definitions_of(StoredTopic(topic.name, name), robot)
            definitions.add({name: text for name, text in found.items() if not definitions.knows(name)})
    except UnknownInterface as error:
        definitions.refuse(topic.type, error)


async def definitions_of(topic: StoredTopic, robot: Robot | None) -> dict[str, DefinitionText]:
    """Return the definition of a topic's type: from the bag itself, else from ROS, else from the robot.

    Raises:
        UnknownInterface: if none of these has it.
    """
    from rosbags.typesys import Stores, TypesysError, get_typestore  # with numpy: not before it is needed

    if found := definitions_in(topic.type, topic.encoding, topic.definition):
        return found
    with suppress(
        TypesysError, KeyError
    ):  # of the packages that every ROS 2 has, as the newest distribution defines them
        common = await asyncio.to_thread(get_typestore, Stores.LATEST)
        text, _ = await asyncio.to_thread(common.generate_msgdef, topic.type, ros_version=2)
        if found := definitions_in(topic.type, "ros2msg", text):
            return found
    unknown = UnknownInterface(
        f"The definition of {named(topic.type)} is missing in the bag.", "The recording does not contain it."
    )
    if robot is not None:
        try:
            await robot.values.learn(topic.type)
            return definitions_in(topic.type, "ros2msg", schema_text(robot.values.definitions.interface(topic.type)))
        except UnknownInterface as error:
            unknown = error
        except LinkError as error:
            hint = f"It is not in the bag, and no robot could be asked: {error.message}"
            unknown = UnknownInterface(unknown.message, hint)
    if topic.encoding and not names.is_derived(topic.type):  # an empty definition is that of a message without fields
        return {topic.type: DefinitionText("msg", "")}
    raise unknown


def has_definition(topic: StoredTopic) -> bool:
    """Return whether the bag itself has a usable definition of a topic's type."""
    from ros2_mcp.values.definitions import Definitions
    from ros2_mcp.values.json_messages import is_usable_schema

    if topic.form == "json":
        return is_usable_schema(topic.definition)
    if topic.form == "other" or not (topic.definition or topic.encoding):
        return False
    definitions = Definitions()
    try:
        definitions.add(
            definitions_in(topic.type, topic.encoding, topic.definition) or {topic.type: DefinitionText("msg", "")}
        )
        return not definitions.unknown_in(topic.type) and bool(definitions.compiled(topic.type))
    except UnknownInterface:
        return False


def find_topic(bag: Bag, name: str) -> StoredTopic:
    """Return a topic of a bag by its name there, or by a name that differs only in the leading slash.

    Raises:
        NotFound: if there is no such topic; it names the nearest one.
    """
    bare = name.strip().lstrip("/")
    for written in (name, name.strip(), f"/{bare}", bare):
        if written in bag.topics:
            return bag.topics[written]
    topics = sorted(bag.topics)
    hint = names.did_you_mean(name, topics, f"It has {', '.join(map(named, topics[:20]))}.")
    raise NotFound(f"{bag.path.name} has no topic {named(name)}.", hint)


def span_in(store: BagStore, bag: Bag, start: str, end: str) -> Span:
    """Return the span between two times that lie in a bag. Raises `BadValue` for others."""
    return span_of(start, end, *times_of(store, bag), within=True)


def times_of(store: BagStore, bag: Bag) -> tuple[int, int]:
    """Return a bag's beginning and end (Unix times, ns); the end is the last message, or now while it is recorded.

    As messages need up to a second to reach the disk, now means a second ago, unless there is a later message.
    """
    first_ns, last_ns = bag.times or (0, 0)
    now_ns = store.recorded_until_ns(bag) if bag.times else None
    if now_ns is not None:
        last_ns = max(last_ns, now_ns - _TO_DISK_NS)
    return first_ns, last_ns


def end_note(source: Source, *texts: str) -> str:
    """Return a sentence on the time from which `last 30 s` was counted, if such a time was given; else nothing."""
    if isinstance(source, BagSource) and any(is_relative(text) for text in texts):
        return f"Times count from the end of the recording, {recorded_time(source.covers[1], source.began_ns)}."
    return ""


# ── samples ──────────────────────────────────────────────────────────────────────────────────────────────────────────


def _taken(samples: Iterable[Sample], limit: int, every_n: int) -> tuple[list[Sample], int, Sample | None]:
    """Return every n-th sample up to limit and `MAX_BYTES`, at least one; the number read, and the next sample."""
    found: list[Sample] = []
    size = passed = 0
    for passed, sample in enumerate(samples):
        if passed % every_n:
            continue
        size += len(sample.data)
        if len(found) == limit or (found and size > MAX_BYTES):
            return found, passed, sample
        found.append(sample)
    return found, passed + 1 if found else 0, None


def _batch(messages: Iterator[tuple[str, Sample]]) -> list[tuple[str, Sample]]:
    found: list[tuple[str, Sample]] = []
    size = 0
    for message in islice(messages, _BATCH):
        found.append(message)
        size += len(message[1].data)
        if size >= _BATCH_BYTES:
            break
    return found


def latched_before(bag: Bag, topic: StoredTopic, span: Span) -> list[Sample]:
    """Return the latched messages that a late subscriber would have received at the beginning, the oldest first."""
    from ros2_mcp.bags.qos import is_latched  # with rosbags: not before it is needed

    if not is_latched(topic.qos):
        return []
    return bag.last(topic.name, len(_publishers(topic)), replace(span, start_ns=0, end_ns=span.start_ns))


def _publishers(topic: StoredTopic) -> list[Endpoint]:
    """Return the publishers: their number and durability are known, their names are not."""
    from ros2_mcp.bags.qos import is_latched, parse_qos  # with rosbags: not before it is needed

    durability = "transient_local" if is_latched(topic.qos) else "volatile"
    publishers = max(len(parse_qos(topic.qos)), 1)
    return [Endpoint(_RECORDED, topic.type, "", "", QoS("unknown", durability, depth=None))] * publishers
