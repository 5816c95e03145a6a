"""The interface of sources: samples of topics from the live robot, a bag or a black box, and what is known about them.

Operations that read take a `Source`. Use `is_live`, never its texts, to tell live sources from recorded ones.
"""

from __future__ import annotations

import asyncio
from abc import ABC, abstractmethod
from collections.abc import AsyncGenerator, Awaitable, Callable, Collection, Mapping, Sequence
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Generic, Protocol, TypeAlias, TypeVar

from ros2_mcp.model import names
from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.qos import Endpoint
from ros2_mcp.model.samples import Counts, Sample
from ros2_mcp.ops.memory.bag_store import BagStore
from ros2_mcp.ops.results.results import Report, silent
from ros2_mcp.robot import Robot, TopicEndpoints
from ros2_mcp.robot.seen import Left
from ros2_mcp.robot.transforms import TransformListener

if TYPE_CHECKING:
    from ros2_mcp.values.cdr import Codec
    from ros2_mcp.values.definitions import Definitions

ANSWER_S = 15.0
"""How long a source may take to answer. A query of a day in a database takes some seconds; if one hangs, there must be
time left to ask the other sources before clients give up the call."""


class Kept(Protocol):
    """Keeps the needed data of the messages of one topic while they are read. Used by one thread at a time."""

    def add(self, samples: Sequence[Sample]) -> None:
        """Add messages, in the order of time."""
        ...


K = TypeVar("K", bound=Kept)
Keep: TypeAlias = "Callable[[Stream], K]"
"""Makes the keeper of a stream's messages. Raises `RobotError` if the type does not allow it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Capture(Generic[K]):
    """The result of capturing one topic: what was `kept` of its messages between two times, and
    what is needed to interpret it.

    `start_ns` and `end_ns` are Unix times by the receiver's clock; only a latched message may be older. `received`
    counts all messages of that time, of which `dropped` were discarded because of memory bounds; `lost` never arrived,
    None if unknown. `publishers` are names of nodes, empty if unknown. `source` describes the source; `began_ns` is the
    source's, `mixed` and `odd_times` are the stream's. `holes` are the times of which a recording cannot be read: a
    silence or a step across one does not come from the robot.
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
    began_ns: int | None = None
    holes: Sequence[tuple[int, int]] = ()
    mixed: str = ""
    odd_times: str = ""

    @property
    def duration_s(self) -> float:
        """The length of the capture in s."""
        return (self.end_ns - self.start_ns) / 1e9

    @property
    def zero_ns(self) -> int:
        """The time from which seconds count: the beginning of the recording, or, live, of the capture."""
        return self.start_ns if self.began_ns is None else self.began_ns

    @property
    def definitions(self) -> Definitions:
        """The definitions with which the messages were written."""
        return self.codec.definitions


@dataclass(frozen=True, slots=True)
class Missing:
    """A topic that could not be captured, with the error."""

    topic: str
    error: RobotError


@dataclass(kw_only=True)
class Stream:
    """The samples of one topic in order, in batches as they come; an empty batch only shows that the stream is alive.

    The batches end with the source's time. This class is a stream of stored samples, up to the Unix time `until_ns`; a
    live stream overrides what differs.

    `qos` describes the subscription's QoS, or the recorded one. Samples from before `start_ns` are latched ones.
    `from_end`: the limit meant the last messages. `thinned`: only every n-th sample is given. `received` samples have
    been read so far. With a limit, `further` is the next sample after the requested ones, in the direction of reading;
    None if there is none. `note` is a sentence for the result. `asked_ns` is when a live stream was requested, by the
    robot's clock.
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
    asked_ns: int = 0

    @property
    def nodes(self) -> list[str]:
        """The names of the publishing nodes."""
        return sorted({publisher.who for publisher in self.publishers})

    @property
    def mixed(self) -> str:
        """A sentence on the publishers whose messages are mixed although one publisher is expected; only live streams
        know publishers.
        """
        return ""

    @property
    def odd_times(self) -> str:
        """A sentence on irregular times in a recording: messages without a time, and times that go back."""
        return ""

    @property
    def left_behind(self) -> str:
        """A sentence on messages that a slow link has left on the robot; empty if there are none."""
        return ""

    @property
    def counts(self) -> Counts:
        """The counts of messages so far. Stored ones are not dropped; the number of lost ones is unknown."""
        return Counts(self.received, 0, None)

    @property
    def covered_s(self) -> float:
        """The length in s of the source's time that the samples cover."""
        return (self.end_ns - self.start_ns) / 1e9

    @property
    def end_ns(self) -> int:
        """The time that the stream has reached, as Unix time in ns."""
        return self.until_ns

    @property
    def holes(self) -> Sequence[tuple[int, int]]:
        """The time spans that cannot be read, in order, as far as they are known after reading."""
        return ()

    @property
    def tells_replayed(self) -> bool:
        """Return whether enough samples have come for `is_replayed` to be certain; at the end
        it is as certain as it can be.
        """
        return True

    def is_replayed(self, sample: Sample) -> bool:
        """Return whether a sample was sent before the source's time, and was received only because its publisher keeps
        messages for late subscribers.
        """
        return sample.received_ns < self.start_ns or 0 < sample.source_ns < self.asked_ns

    async def why_no_more(self, last: Sample | None) -> str:
        """Return a sentence on why no sample came after `last` (None if there was no sample at all)."""
        return f"The recording has {'no more messages' if last else 'no message'} of it in that part."


@dataclass(frozen=True, slots=True)
class GraphSnapshot:
    """The graph as far as a source knows it; None means unknown. `nodes` has a name as often as nodes share it;
    `services` has the types of each service.

    `absence` is a sentence if no robot is there; `left` is what was seen earlier in this session and is gone; `ran` are
    the topics that were streams then.
    """

    topics: Mapping[str, TopicEndpoints]
    nodes: Sequence[str] | None = None
    services: Mapping[str, Sequence[str]] | None = None
    settled: bool = True
    absence: str = ""
    left: Left = field(default_factory=Left)
    ran: Collection[str] = ()


@dataclass(frozen=True, slots=True)
class SourceRequest:
    """The caller's description of a source: its name, a beginning and an end, the bucket of a database.

    `names` are the caller's arguments for the beginning and the end, for errors and for hints on reading on. `waits`:
    the caller has given a time to wait, so that a topic that does not exist yet is awaited, with progress to `report`;
    else it is an error as soon as discovery has settled.
    """

    name: str = ""
    start: str = ""
    end: str = ""
    bucket: str = ""
    names: tuple[str, str] = ("start", "end")
    waits: bool = True
    report: Report = silent


class Source(ABC):
    """The source of samples: the robot for some time from now on, or a part of a recording.

    A new kind of source sets these attributes, implements the abstract methods, and has a `SourceKind`.
    """

    title: str
    """The source in words, as in `the bag run`."""
    words: str
    """The source with its time, for results and people: `live, 5 s`."""
    duration_s: float
    """The length of its time in s."""
    began_ns: int | None = None
    """When a recording began (Unix time, ns), from which `12 s in` counts (`model/times.recorded_time`);
    None if it has no fixed beginning."""
    is_live: bool = False
    """Whether its messages have yet to come. Stored messages need no waiting."""
    from_end: bool = False
    """Whether a limit means the last messages."""
    keeps_types: bool = True
    """Whether it knows the types of its messages; if not, the caller has to give them."""

    @property
    @abstractmethod
    def codec(self) -> Codec:
        """The codec for its samples; it knows the types of the topics that were requested."""

    async def name_of(self, topic: str) -> str:
        """Return the full name of a requested topic. Raises `BadName` if the name is not valid."""
        return names.absolute(topic)

    @abstractmethod
    async def type_of(self, topic: str) -> str:
        """Return the type of a topic; `codec` knows the type from then on.

        Raises:
            NotFound: if the topic does not exist (yet).
            TypeConflict: if it has several types.
        """

    @abstractmethod
    def follow(
        self,
        topic: str,
        type_name: str = "",
        *,
        limit: int | None = None,
        every_n: int = 1,
        latched: bool = True,
        times_only: bool = False,
    ) -> AbstractAsyncContextManager[Stream]:
        """Read every sample of a topic in order, from the beginning of the source's time to its end.

        Args:
            topic: its name; a live topic need not exist yet.
            type_name: needed only if the topic has several types, or, live, none yet.
            limit: how many samples are needed; of a recording without a start these are the last ones. A live stream
                goes on: its reader stops.
            every_n: live, and of a recording with a limit, only every n-th sample is given, counted from the first.
            latched: whether a recording also gives the earlier messages that a late subscriber would have received.
            times_only: only the sizes of the samples and their bytes up to a header's stamp are needed.

        Raises:
            NotFound: if the topic does not appear in that time.
            TypeConflict: if it has several types, or not the given one.
        """

    def lasting(self, live_s: float, *, recorded_s: float | None = None, whole: bool = False) -> Source:  # noqa: ARG002
        """Return the source limited in time: live for `live_s` from now on, of a recording at most
        `recorded_s` (None: all of it).

        `recorded_s` is the caller's argument, if given: live, a topic that does not exist is then awaited. Of a longer
        part of a recording, the beginning is used if a start was given, else the end. `whole`: the time counts from
        when a topic exists, however long that takes; else it includes the wait for the topic.

        Raises:
            BadValue: if the time is out of range.
        """
        return self

    def part(self, start_ns: int, end_ns: int) -> Source:  # noqa: ARG002 - what is live has no other time
        """Return the part between two Unix times of receipt, as far as the source has
        them; a live source returns itself.
        """
        return self

    def from_beginning(self) -> Source:
        """Return the same source with all earlier messages, for values that hold since they were
        published; a live source returns itself.
        """
        return self

    @property
    def covers_ns(self) -> tuple[int, int] | None:
        """The Unix times of receipt (ns) between which it has messages, if known; None for a live source."""
        return None

    @property
    def transforms(self) -> TransformListener | None:
        """The listener of a robot's transforms; None for a recording, which is read on request."""
        return None

    def judging(self) -> Source:
        """Return the same source for readers that judge a state: live, of the messages sent before only the newest
        counts. A recording gives all its messages, in the order of time.
        """
        return self

    def prompt(self) -> Source:
        """Return the same source for readers that react to each message: live, no message waits long in the bridge."""
        return self

    async def lightest(self, topic: str) -> str:
        """Return the topic with the same pictures that is smallest to read, such as the compressed one; by default the
        topic itself.
        """
        return topic

    async def publishing(self, *types: str) -> list[str]:
        """Return the names of the topics of one of these types that have, or had, a publisher, sorted."""
        topics = (await self.graph()).topics
        return sorted(name for name, found in topics.items() if any(one.type in types for one in found.publishers))

    async def absence(self) -> str:
        """Return a sentence if no robot is there; empty if there is a robot, and for recordings."""
        return ""

    def words_after(self, took_s: float) -> str:  # noqa: ARG002 - what was kept is read in no time
        """Return `words` for a read that may have ended before the source's time: `live, 0.26 s of at most 5 s`."""
        return self.words

    async def graph(self) -> GraphSnapshot:
        """Return what is known of the graph."""
        return GraphSnapshot({})

    async def hung(self, nodes: Sequence[str]) -> Sequence[str]:  # noqa: ARG002 - a recording cannot be asked
        """Return some of these nodes if none of them answers a request that every node serves; else empty."""
        return ()

    async def captures(
        self,
        topics: Sequence[str],
        keep: Keep[K],
        report: Report = silent,
        *,
        times_only: bool = False,  # noqa: ARG002 - of what was kept by others, messages come as they are
    ) -> Sequence[Capture[K] | Missing]:
        """Return what `keep` makes of every message of each topic, all over the same time.

        With `times_only` the samples need only the bytes up to a header's stamp.
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
    """A kind of source: it finds the sources of this kind. A subclass overrides one method or both."""

    async def named(self, robot: Robot, store: BagStore, request: SourceRequest) -> Source | None:  # noqa: ARG002
        """Return the requested source, or None if it is not of this kind."""
        return None

    async def kept(
        self,
        robot: Robot,  # noqa: ARG002
        store: BagStore,  # noqa: ARG002
        request: SourceRequest,  # noqa: ARG002
    ) -> Sequence[Callable[[], Awaitable[Source]]]:
        """Return, for each source that may have earlier messages, a function that opens the source; the likeliest
        source first.
        """
        return ()


def captured(source: Source, stream: Stream, kept: K, received: int) -> Capture[K]:
    """Return the capture of a stream that has ended after `received` samples."""
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
        began_ns=source.began_ns,
        holes=stream.holes,
        mixed=stream.mixed,
        odd_times=stream.odd_times,
    )


async def in_batches(samples: Sequence[Sample]) -> AsyncGenerator[Sequence[Sample], None]:
    """Yield samples that are all present already, as one batch."""
    if samples:
        yield samples
