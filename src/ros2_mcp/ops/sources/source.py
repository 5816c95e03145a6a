"""What a source is: samples of topics from the robot now, from a bag, from a black box, and what is known around them.

Operations that read take a `Source`. `is_live` tells live sources from recorded ones, never their text.
"""

from __future__ import annotations

import asyncio
from abc import ABC, abstractmethod
from collections.abc import AsyncGenerator, Awaitable, Callable, Mapping, Sequence
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Generic, Protocol, TypeAlias, TypeVar

from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.qos import Endpoint
from ros2_mcp.model.samples import Counts, Sample
from ros2_mcp.ops.memory.bag_store import BagStore
from ros2_mcp.ops.results import Report, silent
from ros2_mcp.robot import Robot, TopicEndpoints

if TYPE_CHECKING:
    from ros2_mcp.codec.cdr import Codec
    from ros2_mcp.codec.definitions import Definitions

ANSWER_S = 15.0
"""How long a source may take to answer. A question to a database over a day takes some seconds; if one hangs, there
must be time left to ask the other sources before clients give the call up."""


class Kept(Protocol):
    """What is kept of the messages of one topic while they pass. It is asked from one thread at a time."""

    def add(self, samples: Sequence[Sample]) -> None:
        """Takes in messages, in the order of time."""
        ...


K = TypeVar("K", bound=Kept)
Keep: TypeAlias = "Callable[[Stream], K]"
"""Makes what keeps the messages of a stream; raises `RobotError` where that cannot be done with its type."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Capture(Generic[K]):
    """What was `kept` of the messages of one topic between two times, with what is needed to understand it.

    `start_ns` and `end_ns` are Unix times by the receiver's clock; only a latched message may be older.
    `received` counts all that came in that time, of which `dropped` were not looked at because of memory
    bounds; `lost` never came, or None where that cannot be known. `publishers` are names of nodes, empty where they
    are not known. `source` says in words where the messages are from. `holes` are the times of which a recording
    cannot be read: a silence or a step over one is none of the robot's.
    """

    topic: str
    type: str
    codec: Codec
    kept: K
    start_ns: int
    end_ns: int
    received: int
    dropped: int = 0
    lost: int | None = None
    publishers: Sequence[str] = ()
    source: str = ""
    holes: Sequence[tuple[int, int]] = ()

    @property
    def duration_s(self) -> float:
        """How long it is."""
        return (self.end_ns - self.start_ns) / 1e9

    @property
    def definitions(self) -> Definitions:
        """The definitions that the messages were written with."""
        return self.codec.definitions


@dataclass(frozen=True, slots=True)
class Missing:
    """A topic that could not be captured, and why."""

    topic: str
    error: RobotError


@dataclass(kw_only=True)
class Stream:
    """The samples of one topic one after the other, in batches as they come; an empty batch is only a sign of life.

    The batches end with the source's time. As it stands here it is a stream of samples that were kept, up to the Unix
    time `until_ns`; a live one overrides what differs.

    `qos` says how it listens, or what was recorded. Samples from before `start_ns` are latched ones. `from_end`: the
    limit meant the last messages. `thinned`: it is every n-th already. `received` samples have been read so far. With
    a limit, `further` is the next sample after those that were asked for, in the direction of reading; None where
    there are no more. `note` is for whoever shows them.
    """

    topic: str
    type: str
    codec: Codec
    publishers: Sequence[Endpoint]
    batches: AsyncGenerator[Sequence[Sample], None] = field(init=False)
    qos: str = ""
    start_ns: int = 0
    until_ns: int = 0
    from_end: bool = False
    thinned: bool = False
    received: int = 0
    further: Sample | None = None
    note: str = ""

    @property
    def nodes(self) -> list[str]:
        """The names of the publishing nodes."""
        return sorted({publisher.node for publisher in self.publishers})

    @property
    def counts(self) -> Counts:
        """What became of the messages so far. Kept ones are not dropped; how many were lost nobody knows."""
        return Counts(self.received, 0, None)

    @property
    def covered_s(self) -> float:
        """How much of the source's time its samples are of."""
        return (self.end_ns - self.start_ns) / 1e9

    @property
    def end_ns(self) -> int:
        """How far it has come, as Unix time."""
        return self.until_ns

    @property
    def holes(self) -> Sequence[tuple[int, int]]:
        """The times of which nothing of it can be read, in order, as far as that is known when it has been read."""
        return ()

    async def why_no_more(self, last: Sample | None) -> str:
        """In words, why no sample came after `last`; None where none came at all."""
        return f"The recording has {'no more' if last else 'nothing'} of it in that part."


@dataclass(frozen=True, slots=True)
class GraphSnapshot:
    """What a source knows of the graph. `nodes` has a name as often as nodes share it; None is not known."""

    topics: Mapping[str, TopicEndpoints]
    nodes: Sequence[str] | None = None
    services: Sequence[str] | None = None
    settled: bool = True


@dataclass(frozen=True, slots=True)
class SourceRequest:
    """Which source is meant, in the caller's words: its name, a beginning and an end, the bucket of a database."""

    name: str = ""
    start: str = ""
    end: str = ""
    bucket: str = ""


class Source(ABC):
    """Where samples come from: the robot for some time from now on, or a part of what somebody has kept.

    A new kind of source sets these attributes, implements what is abstract here, and has a `SourceKind`.
    """

    title: str
    """What it is, as in `the bag run`."""
    words: str
    """The same with its time, for results and people: `live, 5 s`."""
    duration_s: float
    """How much time it covers."""
    is_live: bool = False
    """Whether its messages have yet to come. Of what was kept, nothing has to be waited for."""
    keeps_types: bool = True
    """Whether it knows the types of its messages; if not, the caller has to give them."""

    @property
    @abstractmethod
    def codec(self) -> Codec:
        """Reads its samples; knows the types of the topics that were asked for."""

    @abstractmethod
    async def type_of(self, topic: str) -> str:
        """The type of a topic, which `codec` knows from then on.

        Raises:
            NotFound: if the topic is not there (yet).
            TypeConflict: if it has several types.
        """

    @abstractmethod
    def follow(
        self, topic: str, type_name: str = "", *, limit: int | None = None, every_n: int = 1, latched: bool = True
    ) -> AbstractAsyncContextManager[Stream]:
        """Every sample of a topic in order, from the beginning of the source's time to its end.

        Args:
            topic: its name; live it need not be there yet.
            type_name: needed only if the topic has several types, or live none yet.
            limit: how many samples are needed; of a recording without a start these are the last ones. A live stream
                goes on: its reader stops.
            every_n: with a limit, a recording gives only every n-th sample, counted from the first that is read.
            latched: whether a recording also gives the earlier messages that a late subscriber would still have got.

        Raises:
            NotFound: if the topic does not appear in that time.
            TypeConflict: if it has several types, or not the given one.
        """

    def lasting(self, live_s: float, *, recorded_s: float | None = None, whole: bool = False) -> Source:  # noqa: ARG002
        """The source for so long: live for `live_s` from now on, of a recording at most `recorded_s` (None: all of it).

        Of a longer part of a recording it is the beginning if a start was given, else the end. `whole`: the time
        counts from when a topic is there, however long that takes; else waiting for it counts too.

        Raises:
            BadValue: if the time is out of range.
        """
        return self

    async def graph(self) -> GraphSnapshot:
        """What is known of the graph."""
        return GraphSnapshot({})

    async def captures(
        self,
        topics: Sequence[str],
        keep: Keep[K],
        report: Report = silent,
        *,
        times_only: bool = False,  # noqa: ARG002 - of what was kept by others, messages come as they are
    ) -> Sequence[Capture[K] | Missing]:
        """What `keep` makes of every message of each topic, all over the same time.

        With `times_only` the samples need no bytes.
        """
        found: list[Capture[K] | Missing] = []
        for number, topic in enumerate(topics):
            await report(float(number), float(len(topics)), f"reading {topic}")
            try:
                async with self.follow(topic) as stream:
                    kept, received = keep(stream), 0
                    async for batch in stream.batches:
                        received += len(batch)
                        await asyncio.to_thread(kept.add, batch)
                    found.append(captured(self, stream, kept, received))
            except RobotError as error:
                found.append(Missing(topic, error))
        return found


class SourceKind:
    """A kind of source: how its sources are found. A kind overrides one method or both."""

    async def named(self, robot: Robot, store: BagStore, request: SourceRequest) -> Source | None:  # noqa: ARG002
        """The source that is meant, or None if it is not of this kind."""
        return None

    async def kept(
        self,
        robot: Robot,  # noqa: ARG002
        store: BagStore,  # noqa: ARG002
        request: SourceRequest,  # noqa: ARG002
    ) -> Sequence[Callable[[], Awaitable[Source]]]:
        """For each of its sources that may have earlier messages a function that opens it, the likeliest first."""
        return ()


def captured(source: Source, stream: Stream, kept: K, received: int) -> Capture[K]:
    """What was kept of a stream that has ended, of which so many samples came."""
    counts = stream.counts
    return Capture(
        topic=stream.topic,
        type=stream.type,
        codec=stream.codec,
        kept=kept,
        start_ns=stream.start_ns,
        end_ns=stream.end_ns,
        received=received + counts.dropped,
        dropped=counts.dropped,
        lost=counts.lost,
        publishers=stream.nodes if source.is_live else (),
        source=source.words,
        holes=stream.holes,
    )


async def in_batches(samples: Sequence[Sample]) -> AsyncGenerator[Sequence[Sample], None]:
    """Samples that are all there already."""
    if samples:
        yield samples
