"""What a source is: samples of topics from the robot now, from a bag, from a black box, and what is known around them.

Operations that read take a `Source`. `is_live` tells live sources from recorded ones, never their text.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import AsyncGenerator, Awaitable, Callable, Mapping, Sequence
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from ros2_mcp.model.errors import BadData, RobotError
from ros2_mcp.model.qos import Endpoint
from ros2_mcp.model.samples import Counts, Sample, header_stamp_ns
from ros2_mcp.ops.memory.bag_store import BagStore
from ros2_mcp.ops.results import Report, silent
from ros2_mcp.ops.sources.selection import Collector, undecodable
from ros2_mcp.robot import Robot, TopicEndpoints

if TYPE_CHECKING:
    from ros2_mcp.codec.cdr import Codec, Message
    from ros2_mcp.codec.definitions import Definitions

MAX_BYTES = 192_000_000
"""Of all topics that are measured together: a minute of a raw camera at 3 MB/s, and affordable beside a robot."""
MAX_SAMPLES = 200_000
"""Of one topic: an IMU at 1 kHz for three minutes."""
ANSWER_S = 15.0
"""How long a source may take to answer. A question to a database over a day takes some seconds; if one hangs, there
must be time left to ask the other sources before clients give the call up."""
_STAMP_END = 12
"""A message that begins with a header has its stamp in bytes 4 to 11, after the header of CDR."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Capture:
    """The samples of one topic between two times, in the order of receipt, with what is needed to read them.

    `start_ns` and `end_ns` are Unix times by the receiver's clock; only a latched message may be older.
    `received` counts all that came in that time, of which `dropped` are not among the samples because of memory
    bounds; `lost` never came, or None where that cannot be known. `publishers` are names of nodes, empty where they
    are not known. `source` says in words where the samples are from.
    """

    topic: str
    type: str
    codec: Codec
    samples: Sequence[Sample]
    start_ns: int
    end_ns: int
    received: int
    dropped: int = 0
    lost: int | None = None
    publishers: Sequence[str] = ()
    source: str = ""

    @property
    def duration_s(self) -> float:
        """How long it is."""
        return (self.end_ns - self.start_ns) / 1e9

    @property
    def definitions(self) -> Definitions:
        """The definitions that the samples were written with."""
        return self.codec.definitions

    def decode(self, sample: Sample) -> Message:
        """The values of one of the samples; raises `BadData` where its bytes do not fit the type."""
        return self.codec.decode(self.type, sample.data)

    def readable(self) -> tuple[Capture, list[Message], str]:
        """Without the samples that are not what their type says; the messages of the others; and in words how many.

        Raises:
            BadData: if none can be decoded.
        """
        samples: list[Sample] = []
        messages: list[Message] = []
        trouble: BadData | None = None
        for sample in self.samples:
            try:
                messages.append(self.decode(sample))
                samples.append(sample)
            except BadData as error:
                trouble = trouble or error
        if trouble is None:
            return self, messages, ""
        if not samples:
            raise trouble
        bad = len(self.samples) - len(samples)
        return replace(self, samples=samples), messages, undecodable(bad, str(trouble))

    def stamps_ns(self) -> list[int] | None:
        """The header's stamp of each sample; None where the type does not begin with a header."""
        if not self.definitions.starts_with_header(self.type):
            return None
        return [header_stamp_ns(sample.data) if len(sample.data) >= _STAMP_END else 0 for sample in self.samples]


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
        self, topics: Sequence[str], report: Report = silent, *, times_only: bool = False
    ) -> Sequence[Capture | Missing]:
        """A capture of each topic, all over the same time: its newest samples, as far as they fit in memory.

        With `times_only` the samples have no bytes.
        """
        found: list[Capture | Missing] = []
        for number, topic in enumerate(topics):
            await report(float(number), float(len(topics)), f"reading {topic}")
            collector = capturing(len(topics), times_only)
            try:
                async with self.follow(topic) as stream:
                    async for batch in stream.batches:
                        collector.add(batch)
                    found.append(captured(self, stream, collector))
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


def capturing(topics: int, times_only: bool) -> Collector:
    """A collector for one topic of `topics` that are measured together and share the memory."""
    return Collector(max_samples=MAX_SAMPLES, max_bytes=MAX_BYTES // max(topics, 1), times_only=times_only)


def captured(source: Source, stream: Stream, collector: Collector, start_ns: int | None = None) -> Capture:
    """What a stream gave, as a capture that begins with the stream or at `start_ns`."""
    counts = stream.counts
    dropped = collector.dropped + counts.dropped
    return Capture(
        topic=stream.topic,
        type=stream.type,
        codec=stream.codec,
        samples=list(collector.samples),
        start_ns=stream.start_ns if start_ns is None else start_ns,
        end_ns=stream.end_ns,
        received=len(collector.samples) + dropped,
        dropped=dropped,
        lost=counts.lost,
        publishers=stream.nodes if source.is_live else (),
        source=source.words,
    )


async def in_batches(samples: Sequence[Sample]) -> AsyncGenerator[Sequence[Sample], None]:
    """Samples that are all there already."""
    if samples:
        yield samples
