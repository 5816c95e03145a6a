"""The robot as it is now, as a source of samples."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncGenerator, Sequence
from contextlib import AsyncExitStack, aclosing, asynccontextmanager
from dataclasses import dataclass, replace
from time import monotonic
from typing import TYPE_CHECKING

from ros2_mcp.guard.policy import bounded
from ros2_mcp.model import names
from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.samples import Counts, Sample
from ros2_mcp.ops.memory.bag_store import BagStore
from ros2_mcp.ops.results import Report, iso_time, reporting, silent
from ros2_mcp.ops.sources.selection import Collector
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
from ros2_mcp.robot import Listening, Robot, TopicEndpoints
from ros2_mcp_bridge.limits import MAX_DURATION_S

if TYPE_CHECKING:
    from ros2_mcp.codec.cdr import Codec

_MATCHING_S = 0.5
"""Matching takes 20 to 200 ms on one host; a topic that is slower than 2 Hz would only keep the others waiting."""
_TURN_S = 1.0
"""The longest single wait for samples; the empty batch after it is the sign of life that a stream gives."""
_NAMES_S = 1.0
"""Fast DDS tells a node's name up to half a second after its endpoints."""
MAX_BYTES = 192_000_000
"""Of all topics that are measured together: a minute of a raw camera at 3 MB/s, and affordable beside a robot."""
MAX_SAMPLES = 200_000
"""Of one topic: an IMU at 1 kHz for three minutes."""
_TURN_SAMPLES = 200
"""Decoded in one go of a thread: some 10 ms, so that a cancelled call ends at once."""
_UNNAMED = names.full_node_name("_NODE_NAME_UNKNOWN_", "/")
_ASKED_AT_ONCE = 32
"""Questions to the bridge that are under way together; it answers one after the other."""


@dataclass(kw_only=True)
class _LiveStream(Stream):
    """A subscription; the call that made it began at the steady time `asked_at`, waiting for the topic included."""

    robot: Robot
    listening: Listening
    asked_at: float

    @property
    def counts(self) -> Counts:
        return self.listening.counts

    @property
    def covered_s(self) -> float:
        return monotonic() - self.asked_at

    @property
    def end_ns(self) -> int:
        return time.time_ns()

    async def why_no_more(self, last: Sample | None) -> str:
        now = await self.robot.graph.endpoints(self.topic)
        if last is not None:
            left = len(self.publishers) - len(now.publishers)
            gone = f" {left} publisher(s) left during the read." if left > 0 else ""
            at = iso_time(last.received_ns)
            return f"The time ended before all the messages came; the last came at {at}.{gone}"
        if not now.publishers:
            return "Nobody publishes on it now." if not self.publishers else "Its publisher left during the read."
        if self.type not in {publisher.type for publisher in now.publishers}:
            return f"It is published with the type {', '.join(now.types)}."
        nodes = ", ".join(sorted({publisher.node for publisher in now.publishers}))
        return f"{len(now.publishers)} publisher(s) there, but no message came while this listened: {nodes}."

    async def take_until(self, deadline: float) -> AsyncGenerator[Sequence[Sample], None]:
        """What comes before that steady time."""
        while (left := deadline - monotonic()) > 0:
            yield await self.listening.take(min(left, _TURN_S))
        yield await self.listening.take(0.0)


class Live(Source):
    """What the robot does for `duration_s` from the call on.

    With `whole` that time begins when the topic is there, however long that took; else waiting for it counts too.
    """

    title = "the robot"
    is_live = True

    def __init__(self, robot: Robot, duration_s: float = 0.0, *, whole: bool = False) -> None:
        bounded("duration", duration_s, 0.0, MAX_DURATION_S, "s")
        self.words = f"live, {duration_s:g} s"
        self.duration_s = duration_s
        self._robot = robot
        self._whole = whole

    @property
    def codec(self) -> Codec:
        """Reads what the robot sends."""
        return self._robot.values.codec

    def lasting(self, live_s: float, *, recorded_s: float | None = None, whole: bool = False) -> Live:  # noqa: ARG002
        """The robot for so long from now on."""
        return Live(self._robot, live_s, whole=whole)

    async def type_of(self, topic: str) -> str:
        """The type of a topic that is there now; raises as `Source.type_of`."""
        type_name = await self._robot.types.topic(await self._robot.graph.endpoints(names.absolute(topic)), "")
        await self._robot.values.learn(type_name)
        return type_name

    async def captures(
        self, topics: Sequence[str], keep: Keep[K], report: Report = silent, *, times_only: bool = False
    ) -> Sequence[Capture[K] | Missing]:
        """Listens to all topics over truly the same time, which begins when every subscription has been matched."""

        async def opened(topic: str) -> _LiveStream | Missing:
            try:
                return self._stream(await subscriptions.enter_async_context(self._robot.listen(topic)), monotonic())
            except RobotError as error:
                return Missing(topic, error)

        async def collect(stream: _LiveStream) -> None:
            async for batch in stream.take_until(deadline):
                collectors[id(stream)].add(batch)

        def progress() -> str:
            return ", ".join(f"{one.topic}: {len(collectors[id(one)].samples)} messages" for one in streams)

        async with AsyncExitStack() as subscriptions:
            results = await asyncio.gather(*map(opened, topics))
            streams = [result for result in results if isinstance(result, _LiveStream)]
            await _matched(streams)
            start_ns, deadline = time.time_ns(), monotonic() + self.duration_s
            # By stream, not by topic: one topic may be asked for twice, and each is a capture of its own.
            most_bytes = MAX_BYTES // max(len(streams), 1)
            collectors = {
                id(stream): Collector(max_samples=MAX_SAMPLES, max_bytes=most_bytes, times_only=times_only)
                for stream in streams
            }
            async with reporting(report, self.duration_s, progress):
                await asyncio.gather(*map(collect, streams))
            end_ns = time.time_ns()
        for stream in streams:  # what was received before the end and sent to us after it
            collectors[id(stream)].add(await stream.listening.take(0.0))
        found: list[Capture[K] | Missing] = []
        for result in results:
            try:
                if isinstance(result, Missing):
                    found.append(result)
                else:
                    found.append(await self._capture(result, keep(result), collectors[id(result)], start_ns, end_ns))
            except RobotError as error:
                found.append(Missing(result.topic, error))
        return found

    @asynccontextmanager
    async def follow(
        self,
        topic: str,
        type_name: str = "",
        *,
        limit: int | None = None,  # noqa: ARG002 - the reader stops by itself
        every_n: int = 1,  # noqa: ARG002
        latched: bool = True,  # noqa: ARG002 - the publishers decide
    ) -> AsyncGenerator[Stream, None]:
        """Every sample from now on; waits for the topic to appear."""
        asked_at = monotonic()
        async with self._robot.listen(topic, type_name, wait_s=self.duration_s) as listening:
            stream = self._stream(listening, asked_at)
            stream.batches = stream.take_until((monotonic() if self._whole else asked_at) + self.duration_s)
            async with aclosing(stream.batches):
                yield stream

    async def graph(self) -> GraphSnapshot:
        """The graph now, without our own nodes."""
        graph = self._robot.graph
        topics = await graph.topics()
        nodes = await graph.nodes()
        services = await graph.services()
        own = graph.own_nodes
        limit = asyncio.Semaphore(_ASKED_AT_ONCE)

        async def endpoints(topic: str) -> TopicEndpoints:
            async with limit:
                present = await self._named(topic)
            return TopicEndpoints(
                topic,
                [publisher for publisher in present.publishers if publisher.node not in own],
                [subscriber for subscriber in present.subscribers if subscriber.node not in own],
            )

        present = await asyncio.gather(*(endpoints(row.name) for row in topics))
        return GraphSnapshot(
            {found.topic: found for found in present if found.types},
            sorted(row.name for row in nodes if row.name not in own),
            sorted(row.name for row in services),
            topics.settled and nodes.settled,
        )

    async def _named(self, topic: str) -> TopicEndpoints:
        """The endpoints of a topic; waits for the names of nodes that have only just appeared, at most 1 s."""
        deadline = monotonic() + _NAMES_S
        found = await self._robot.graph.endpoints(topic)
        while monotonic() < deadline and _UNNAMED in {one.node for one in (*found.publishers, *found.subscribers)}:
            await asyncio.sleep(0.1)  # a tenth of the time: at most ten questions for each topic
            found = await self._robot.graph.endpoints(topic)
        return found

    def _stream(self, listening: Listening, asked_at: float) -> _LiveStream:
        qos = listening.choice.qos
        return _LiveStream(
            topic=listening.topic,
            type=listening.type,
            codec=self.codec,
            publishers=listening.publishers,
            qos=f"{qos.reliability}, {qos.durability}: {listening.choice.reason}",
            robot=self._robot,
            listening=listening,
            asked_at=asked_at,
        )

    async def _capture(
        self, stream: _LiveStream, kept: K, collector: Collector, start_ns: int, end_ns: int
    ) -> Capture[K]:
        """What was received between both times; of a latched topic also what was there before."""
        latched = stream.listening.choice.qos.durability == "transient_local"
        earliest_ns = 0 if latched else start_ns
        samples = [sample for sample in collector.samples if earliest_ns <= sample.received_ns <= end_ns]
        for begin in range(0, len(samples), _TURN_SAMPLES):
            await asyncio.to_thread(kept.add, samples[begin : begin + _TURN_SAMPLES])
        whole = captured(self, stream, kept, len(samples))
        dropped = whole.dropped + collector.dropped
        return replace(whole, start_ns=start_ns, end_ns=end_ns, received=len(samples) + dropped, dropped=dropped)


async def _matched(streams: Sequence[_LiveStream]) -> None:
    """Waits, at most half a second, until a message has come on every topic that has a publisher."""
    deadline = monotonic() + _MATCHING_S
    while monotonic() < deadline and not all(stream.counts.received for stream in streams if stream.publishers):
        await asyncio.sleep(0.01)  # short beside the 20 ms that matching takes at least


class Robots(SourceKind):
    """The robot of this server as a kind of source."""

    async def named(self, robot: Robot, store: BagStore, request: SourceRequest) -> Source | None:  # noqa: ARG002
        """The robot now, if no other source is named."""
        return None if request.name else Live(robot)
