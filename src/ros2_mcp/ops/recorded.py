"""A bag as a source of samples: what measures the robot measures a recording of it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Iterator, Sequence
from contextlib import aclosing, asynccontextmanager
from dataclasses import replace
from itertools import chain, islice
from typing import TYPE_CHECKING

from ros2_mcp.model import names
from ros2_mcp.model.errors import BadValue, RobotError, TypeConflict
from ros2_mcp.model.qos import Endpoint, QoS
from ros2_mcp.model.samples import Counts, Sample
from ros2_mcp.ops.bags import definitions_of, find_topic, span_in, taken, times_of
from ros2_mcp.ops.memory import Memory, OpenedBag
from ros2_mcp.ops.results import Report, iso_time, silent
from ros2_mcp.ops.window import Missing, Scene, Stream, Window
from ros2_mcp.robot import Robot, TopicEndpoints

if TYPE_CHECKING:
    from ros2_mcp.bags.bag import Bag
    from ros2_mcp.bags.stored import Span, StoredTopic
    from ros2_mcp.codec.cdr import Codec

MAX_BYTES = 192_000_000
MAX_SAMPLES = 200_000
_BATCH = 256
_BATCH_BYTES = 8_000_000
_RECORDED = "(recorded)"


class BagSource:
    """A part of a bag, as a `Source`; get it with `open_source`.

    `from_end` tells that who wants only some samples means the last ones.
    """

    def __init__(self, memory: Memory, name: str, span: Span, robot: Robot | None, *, from_end: bool = False) -> None:
        from ros2_mcp.codec.cdr import Codec
        from ros2_mcp.codec.definitions import Definitions

        self._memory = memory
        self._name = name
        self._span = span
        self._robot = robot
        self._from_end = from_end
        self._codec = Codec(Definitions())

    @property
    def words(self) -> str:
        """What it is, in words."""
        return f"bag {self._name}, {self.duration_s:g} s from {iso_time(self._span.start_ns)} on"

    @property
    def duration_s(self) -> float:
        """How much time it covers."""
        return (self._span.end_ns - self._span.start_ns) / 1e9

    @property
    def codec(self) -> Codec:
        """Reads its samples, with the definitions of the bag."""
        return self._codec

    async def type_of(self, topic: str) -> str:
        """The type of a topic; raises as `Source.type_of`."""
        return (await self._learn(topic)).type

    async def windows(
        self, topics: Sequence[str], report: Report = silent, *, times_only: bool = False
    ) -> Sequence[Window | Missing]:
        """A window for each topic; where there is too much, the newest samples, and the others are counted."""
        found: list[Window | Missing] = []
        for number, name in enumerate(topics):
            await report(float(number), float(len(topics)), f"reading {name}")
            try:
                topic = await self._learn(name)
                found.append(await asyncio.to_thread(self._window, topic, MAX_BYTES // len(topics), times_only))
            except RobotError as error:
                found.append(Missing(name, error))
        return found

    @asynccontextmanager
    async def follow(self, topic: str, type_name: str = "", *, most: int | None = None) -> AsyncGenerator[Stream, None]:
        """Every sample of a topic in order, after a latched one from before; with `most` and no start the last ones."""
        stored = await self._learn(topic)
        if type_name and names.interface_type(type_name, "msg") != stored.type:
            raise TypeConflict(f"{stored.name} has the type {stored.type}, not {type_name}.", "Leave the type out.")
        given = [0]
        last = most if self._from_end else None
        publishers = _publishers(stored)
        async with aclosing(self._batches(stored, last, given)) as batches:
            yield Stream(
                stored.name,
                stored.type,
                self._codec,
                publishers,
                batches,
                lambda: Counts(given[0], 0, None),
                self._why_no_more,
                lambda: self.duration_s,
                f"{publishers[0].qos.durability}, as it was recorded",
                self._span.start_ns,
                lambda: self._span.end_ns,
            )

    async def _why_no_more(self, last: Sample | None) -> str:
        return f"The recording has {'no more' if last else 'nothing'} of it in that part."

    async def scene(self) -> Scene:
        """The topics with what their publishers offered; nodes and services are not in a bag."""

        def read() -> dict[str, TopicEndpoints]:
            with self._memory.reading(self._name) as bag:
                return {topic.name: TopicEndpoints(topic.name, _publishers(topic), ()) for topic in bag.topics.values()}

        return Scene(await asyncio.to_thread(read), None, None)

    async def _learn(self, name: str) -> StoredTopic:
        topic = await asyncio.to_thread(self._topic, name)
        if not self._codec.definitions.knows(topic.type):
            self._codec.definitions.add(await definitions_of(topic, self._robot))
        return topic

    def _topic(self, name: str) -> StoredTopic:
        with self._memory.reading(self._name) as bag:
            return find_topic(bag, names.absolute(name))

    def _window(self, topic: StoredTopic, max_bytes: int, times_only: bool) -> Window:
        span = replace(self._span, topics=(topic.name,))
        kept: list[Sample] = []
        size = received = 0
        with self._memory.reading(self._name) as bag:
            for _, sample in bag.messages(span, newest_first=True):
                received += 1
                size += 0 if times_only else len(sample.data)
                if len(kept) < MAX_SAMPLES and (size <= max_bytes or not kept):
                    kept.append(replace(sample, data=b"") if times_only else sample)
            kept += _latched_before(bag, topic, span)
        start_ns, end_ns = self._span.start_ns, self._span.end_ns
        dropped = max(received - len(kept), 0)
        return Window(
            topic.name, topic.type, self._codec, kept[::-1], start_ns, end_ns, received, dropped, source=self.words
        )

    async def _batches(
        self, topic: StoredTopic, last: int | None, given: list[int]
    ) -> AsyncGenerator[Sequence[Sample], None]:
        """Of the bag as it is at the beginning, although it may grow meanwhile."""
        span = replace(self._span, topics=(topic.name,))

        def begun() -> tuple[OpenedBag, Iterator[Sample]]:
            opened = self._memory.opened(self._name)
            with opened.reading() as bag:
                return opened, _first(bag, topic, span) if last is None else _last(bag, topic, span, last)

        def following(opened: OpenedBag, messages: Iterator[Sample]) -> list[Sample]:
            with opened.lock:
                return _batch(messages)

        opened, messages = await asyncio.to_thread(begun)
        while batch := await asyncio.to_thread(following, opened, messages):
            given[0] += len(batch)
            yield batch


async def open_source(
    memory: Memory,
    bag: str,
    start: str = "",
    end: str = "",
    robot: Robot | None = None,
    *,
    longest_s: float | None = None,
) -> BagSource:
    """A bag, or the part of it between two moments (as `moments.span_of` reads them), as a `Source`.

    Of a part that is longer than `longest_s` it is the beginning if a start is given, else the end.

    Raises:
        NotFound: if there is no such bag.
        BadData: if nothing of it can be read.
        BadValue: if a moment cannot be understood, or nothing was recorded in that time.
    """
    span = await asyncio.to_thread(_bounds, memory, bag, start, end)
    from_end = not start.strip()
    if longest_s is not None:
        longest_ns = max(round(longest_s * 1e9), 1)
        start_ns = max(span.start_ns, span.end_ns - longest_ns) if from_end else span.start_ns
        span = replace(span, start_ns=start_ns, end_ns=min(span.end_ns, start_ns + longest_ns))
    return BagSource(memory, bag, span, robot, from_end=from_end)


def _bounds(memory: Memory, name: str, start: str, end: str) -> Span:
    """The part as times that the bag really has."""
    with memory.reading(name) as bag:
        span = span_in(memory, bag, start, end)
        first_ns, last_ns = times_of(memory, bag)
        start_ns, end_ns = max(span.start_ns, first_ns), min(span.end_ns, last_ns + 1)
        if end_ns <= start_ns:
            raise BadValue("start" if start else "end", f"{name} has nothing in that time.", _covers(first_ns, last_ns))
        return replace(span, start_ns=start_ns, end_ns=end_ns)


def _covers(first_ns: int, last_ns: int) -> str:
    return f"It goes from {iso_time(first_ns)} to {iso_time(last_ns)}."


def _batch(messages: Iterator[Sample]) -> list[Sample]:
    found: list[Sample] = []
    size = 0
    for sample in messages:
        found.append(sample)
        size += len(sample.data)
        if len(found) >= _BATCH or size >= _BATCH_BYTES:
            break
    return found


def _first(bag: Bag, topic: StoredTopic, span: Span) -> Iterator[Sample]:
    """All samples, after a latched one that was there before."""
    return chain(_latched_before(bag, topic, span), (sample for _, sample in bag.messages(span)))


def _last(bag: Bag, topic: StoredTopic, span: Span, most: int) -> Iterator[Sample]:
    """The last samples, as many of them as fit in memory, the oldest first."""
    newest = (sample for _, sample in bag.messages(span, newest_first=True))
    found, beyond = taken(islice(newest, most), most, MAX_BYTES)
    before = [] if beyond or len(found) == most else _latched_before(bag, topic, span)
    return chain(before, reversed(found))


def _latched_before(bag: Bag, topic: StoredTopic, span: Span) -> list[Sample]:
    from ros2_mcp.bags.qos import is_latched

    if not is_latched(topic.qos):
        return []
    return bag.last(topic.name, len(_publishers(topic)), replace(span, start_ns=0, end_ns=span.start_ns))


def _publishers(topic: StoredTopic) -> list[Endpoint]:
    from ros2_mcp.bags.qos import is_latched, parse_qos

    durability = "transient_local" if is_latched(topic.qos) else "volatile"
    publishers = max(len(parse_qos(topic.qos)), 1)
    return [Endpoint(_RECORDED, topic.type, "", "", QoS("unknown", durability, depth=None))] * publishers
