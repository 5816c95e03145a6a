"""The seam between live and recorded: windows of samples, streams of samples, and what is known around them.

Operations that measure take a `Source` and never ask whether it is the robot now or a recording of it.
"""

from __future__ import annotations

import time
from collections.abc import AsyncGenerator, Awaitable, Callable, Mapping, Sequence
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.qos import Endpoint
from ros2_mcp.model.samples import Counts, Sample, header_stamp_ns
from ros2_mcp.ops.results import Report
from ros2_mcp.robot import TopicEndpoints

if TYPE_CHECKING:
    from ros2_mcp.codec.cdr import Codec, Message
    from ros2_mcp.codec.definitions import Definitions

_STAMP_END = 12


@dataclass(frozen=True, slots=True)
class Window:
    """The samples of one topic between two moments, in the order of receipt, with what is needed to read them.

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
        """How long the window is."""
        return (self.end_ns - self.start_ns) / 1e9

    @property
    def definitions(self) -> Definitions:
        """The definitions that the samples were written with."""
        return self.codec.definitions

    def decode(self, sample: Sample) -> Message:
        """The values of one of the samples; raises `BadData` where its bytes do not fit the type."""
        return self.codec.decode(self.type, sample.data)

    def stamps_ns(self) -> list[int] | None:
        """The header's stamp of each sample; None where the type does not begin with a header."""
        if not self.definitions.starts_with_header(self.type):
            return None
        return [header_stamp_ns(each.data) if len(each.data) >= _STAMP_END else 0 for each in self.samples]


@dataclass(frozen=True, slots=True)
class Missing:
    """A topic of which there is no window, and why."""

    topic: str
    error: RobotError


@dataclass(frozen=True, slots=True)
class Stream:
    """The samples of one topic one after the other, in batches as they come; an empty batch is only a sign of life.

    The batches end with the source's time. `counts` tells what became of the messages so far, `why_no_more` in words
    why none came after the given last one, `covered_s` how much of the source's time they are of. `qos` says how it
    listens, or what was recorded. Samples from before `start_ns` are latched ones; `end_ns` is how far it has come.
    """

    topic: str
    type: str
    codec: Codec
    publishers: Sequence[Endpoint]
    batches: AsyncGenerator[Sequence[Sample], None]
    counts: Callable[[], Counts]
    why_no_more: Callable[[Sample | None], Awaitable[str]]
    covered_s: Callable[[], float]
    qos: str = ""
    start_ns: int = 0
    end_ns: Callable[[], int] = time.time_ns

    @property
    def nodes(self) -> list[str]:
        """The names of the publishing nodes."""
        return sorted({publisher.node for publisher in self.publishers})


@dataclass(frozen=True, slots=True)
class Scene:
    """What a source knows of the graph. `nodes` has a name as often as nodes share it; None is not known."""

    topics: Mapping[str, TopicEndpoints]
    nodes: Sequence[str] | None
    services: Sequence[str] | None
    settled: bool = True


class Source(Protocol):
    """Where samples come from: the robot for some time from now on, or a part of a recording."""

    @property
    def words(self) -> str:
        """What it is, in words, such as `live, 5 s`."""
        ...

    @property
    def duration_s(self) -> float:
        """How much time it covers."""
        ...

    @property
    def codec(self) -> Codec:
        """Reads its samples; knows the types of the topics that were asked for."""
        ...

    async def type_of(self, topic: str) -> str:
        """The type of a topic, which `codec` knows from then on.

        Raises:
            NotFound: if the topic is not there (yet).
            TypeConflict: if it has several types.
        """
        ...

    async def windows(
        self, topics: Sequence[str], report: Report, *, times_only: bool = False
    ) -> Sequence[Window | Missing]:
        """A window for each topic, all over the same time. With `times_only` the samples have no bytes."""
        ...

    def follow(
        self, topic: str, type_name: str = "", *, most: int | None = None
    ) -> AbstractAsyncContextManager[Stream]:
        """Every sample of a topic in order, from the beginning of the source's time to its end.

        Args:
            topic: its name; live it need not be there yet.
            type_name: needed only if the topic has several types, or live none yet.
            most: how many samples are wanted; of a recording without a start these are the last ones.

        Raises:
            NotFound: if the topic does not appear in that time.
            TypeConflict: if it has several types, or not the given one.
        """
        ...

    async def scene(self) -> Scene:
        """What is known of the graph."""
        ...
