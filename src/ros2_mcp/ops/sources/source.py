"""What a source is: samples of topics from the robot now, from a bag, from a black box, and what is known around them.

Operations that read take a `Source`. `is_live` tells live sources from recorded ones, never their text.
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
    are not known. `source` says in words where the messages are from; `began_ns` is that of the source, `mixed` and
    `odd_times` those of the stream. `holes` are the times of which a recording cannot be read: a silence or a step over
    one is none of the robot's.
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
        """How long it is."""
        return (self.end_ns - self.start_ns) / 1e9

    @property
    def zero_ns(self) -> int:
        """The time from which seconds count: the recording's beginning, live that of the capture."""
        return self.start_ns if self.began_ns is None else self.began_ns

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
    there are no more. `note` is for whoever shows them. `asked_ns` is when a live one was asked for, by the
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
        """In words, whose messages are mixed in it though one publisher is expected; who published is known live."""
        return ""

    @property
    def odd_times(self) -> str:
        """In words, what is odd about the times of a recording of it: messages without one, and where they go back."""
        return ""

    @property
    def left_behind(self) -> str:
        """In words, how many of its messages a slow link has left on the robot; empty where there are none."""
        return ""

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

    @property
    def tells_replayed(self) -> bool:
        """Whether enough has come for `is_replayed` to be sure; at the end it is as sure as it can be."""
        return True

    def is_replayed(self, sample: Sample) -> bool:
        """Whether it was sent before the source's time, and came only because a late subscriber is given it, too."""
        return sample.received_ns < self.start_ns or 0 < sample.source_ns < self.asked_ns

    async def why_no_more(self, last: Sample | None) -> str:
        """In words, why no sample came after `last`; None where none came at all."""
        return f"The recording has {'no more' if last else 'nothing'} of it in that part."


@dataclass(frozen=True, slots=True)
class GraphSnapshot:
    """What a source knows of the graph. `nodes` has a name as often as nodes share it, `services` the types of each;
    None is not known.

    `absence` says in words that no robot is there; `left` is what was seen of it earlier in this session, and `ran` the
    topics that were a stream then.
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
    """Which source is meant, in the caller's words: its name, a beginning and an end, the bucket of a database.

    `names` are the caller's arguments for the beginning and the end, for errors and for how to read on. `waits`: the
    caller has given a time to wait, so that a topic that is not there yet is waited for, which `report` is told; else
    that is an error as soon as discovery has settled.
    """

    name: str = ""
    start: str = ""
    end: str = ""
    bucket: str = ""
    names: tuple[str, str] = ("start", "end")
    waits: bool = True
    report: Report = silent


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
    began_ns: int | None = None
    """For `model/times.recorded_time`: when a recording began, from which `12 s in` counts; None where it does not."""
    is_live: bool = False
    """Whether its messages have yet to come. Of what was kept, nothing has to be waited for."""
    from_end: bool = False
    """Whether a limit means the last messages."""
    keeps_types: bool = True
    """Whether it knows the types of its messages; if not, the caller has to give them."""

    @property
    @abstractmethod
    def codec(self) -> Codec:
        """Reads its samples; knows the types of the topics that were asked for."""

    async def name_of(self, topic: str) -> str:
        """The full name of a topic that somebody asks for; raises `BadName` where there can be none of that name."""
        return names.absolute(topic)

    @abstractmethod
    async def type_of(self, topic: str) -> str:
        """The type of a topic, which `codec` knows from then on.

        Raises:
            NotFound: if the topic is not there (yet).
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
        """Every sample of a topic in order, from the beginning of the source's time to its end.

        Args:
            topic: its name; live it need not be there yet.
            type_name: needed only if the topic has several types, or live none yet.
            limit: how many samples are needed; of a recording without a start these are the last ones. A live stream
                goes on: its reader stops.
            every_n: live, and of a recording with a limit, only every n-th sample is given, counted from the first.
            latched: whether a recording also gives the earlier messages that a late subscriber would still have got.
            times_only: no more of the samples is needed than their sizes and the bytes of a header's stamp.

        Raises:
            NotFound: if the topic does not appear in that time.
            TypeConflict: if it has several types, or not the given one.
        """

    def lasting(self, live_s: float, *, recorded_s: float | None = None, whole: bool = False) -> Source:  # noqa: ARG002
        """The source for so long: live for `live_s` from now on, of a recording at most `recorded_s` (None: all of it).

        `recorded_s` is what the caller has given, if anything: live, a topic that is not there is then waited for.
        Of a longer part of a recording it is the beginning if a start was given, else the end. `whole`: the time
        counts from when a topic is there, however long that takes; else waiting for it counts too.

        Raises:
            BadValue: if the time is out of range.
        """
        return self

    def part(self, start_ns: int, end_ns: int) -> Source:  # noqa: ARG002 - what is live has no other time
        """The part of it between two Unix times of receipt, as far as it has them; live it is the source itself."""
        return self

    def from_beginning(self) -> Source:
        """The same with all that was received before it, for what holds from when it was told on; live it is itself."""
        return self

    @property
    def covers_ns(self) -> tuple[int, int] | None:
        """The Unix times of receipt between which it has messages, where that is known; None for what is live."""
        return None

    @property
    def transforms(self) -> TransformListener | None:
        """What has been listening to the frames of a robot; None for a recording, which is read when it is asked."""
        return None

    def judging(self) -> Source:
        """The same for those who judge a state by its messages: live, of what was sent before only the newest counts.
        A recording gives all that it has, in the order of its time.
        """
        return self

    def prompt(self) -> Source:
        """The same for those who react to each message: live, none waits in the bridge for long."""
        return self

    async def lightest(self, topic: str) -> str:
        """The topic with the same pictures that is the least to read: itself, where that makes no difference."""
        return topic

    async def publishing(self, *types: str) -> list[str]:
        """The names of the topics of one of these types that somebody publishes, or has published, in order."""
        topics = (await self.graph()).topics
        return sorted(name for name, found in topics.items() if any(one.type in types for one in found.publishers))

    async def absence(self) -> str:
        """That no robot is there, as a sentence; empty where one is, and of what was kept."""
        return ""

    def words_after(self, took_s: float) -> str:  # noqa: ARG002 - what was kept is read in no time
        """`words`, where reading may have ended before the source's time did: `live, 0.26 s of at most 5 s`."""
        return self.words

    async def graph(self) -> GraphSnapshot:
        """What is known of the graph."""
        return GraphSnapshot({})

    async def hung(self, nodes: Sequence[str]) -> Sequence[str]:  # noqa: ARG002 - a recording cannot be asked
        """Some of these nodes, if they are asked a question that every node answers, and not one of them does."""
        return ()

    async def captures(
        self,
        topics: Sequence[str],
        keep: Keep[K],
        report: Report = silent,
        *,
        times_only: bool = False,  # noqa: ARG002 - of what was kept by others, messages come as they are
    ) -> Sequence[Capture[K] | Missing]:
        """What `keep` makes of every message of each topic, all over the same time.

        With `times_only` the samples need no more bytes than those of a header's stamp.
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
        began_ns=source.began_ns,
        holes=stream.holes,
        mixed=stream.mixed,
        odd_times=stream.odd_times,
    )


async def in_batches(samples: Sequence[Sample]) -> AsyncGenerator[Sequence[Sample], None]:
    """Samples that are all there already."""
    if samples:
        yield samples
