"""The robot as it is now, as a source of samples."""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import AsyncGenerator, Collection, Sequence
from contextlib import AsyncExitStack, aclosing, asynccontextmanager
from dataclasses import replace
from time import monotonic
from typing import TYPE_CHECKING

from ros2_mcp.guard.policy import MAX_DURATION_S, bounded
from ros2_mcp.model import names
from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.qos import Endpoint
from ros2_mcp.model.samples import Sample
from ros2_mcp.ops.results import Report, iso_time, silent
from ros2_mcp.ops.window import Missing, Scene, Stream, Window
from ros2_mcp.robot import Listening, Robot, TopicEndpoints

if TYPE_CHECKING:
    from ros2_mcp.codec.cdr import Codec

MAX_BYTES = 192_000_000
MAX_SAMPLES = 200_000
_MATCHING_S = 0.5
_TURN_S = 1.0
_NAMES_S = 1.0
_UNNAMED = names.full_node_name("_NODE_NAME_UNKNOWN_", "/")
_ASKED_AT_ONCE = 32


class Live:
    """What the robot does from the moment of asking on, for `duration_s`.

    `whole` time is followed once a topic is there, however long that took; else the waiting counts too.
    """

    def __init__(self, robot: Robot, duration_s: float, *, whole: bool = False) -> None:
        bounded("duration", duration_s, 0.0, MAX_DURATION_S, "s")
        self._robot = robot
        self._duration_s = duration_s
        self._whole = whole

    @property
    def words(self) -> str:
        """What it is, in words."""
        return f"live, {self._duration_s:g} s"

    @property
    def duration_s(self) -> float:
        """How long it listens."""
        return self._duration_s

    @property
    def codec(self) -> Codec:
        """Reads what the robot sends."""
        return self._robot.values.codec

    async def type_of(self, topic: str) -> str:
        """The type of a topic that is there now; raises as `Source.type_of`."""
        type_name = await self._robot.types.topic(await self._robot.graph.endpoints(names.absolute(topic)), "")
        await self._robot.values.learn(type_name)
        return type_name

    async def windows(
        self, topics: Sequence[str], report: Report = silent, *, times_only: bool = False
    ) -> Sequence[Window | Missing]:
        """Listens to all topics over truly the same time, which begins when every subscription has been matched."""
        async with AsyncExitStack() as subscriptions:
            listenings = [await self._subscribe(subscriptions, topic) for topic in topics]
            heard = [each for each in listenings if isinstance(each, Listening)]
            await _matched(heard)
            start_ns = time.time_ns()
            kept = await asyncio.gather(*(self._collect(each, len(heard), times_only, report) for each in heard))
            end_ns = time.time_ns()
        for each, samples in zip(heard, kept, strict=True):
            samples.add(await each.take(0.0))  # what was received before the end and sent to us after it
        by_topic = {
            each.topic: self._window(each, samples, start_ns, end_ns) for each, samples in zip(heard, kept, strict=True)
        }
        return [by_topic[each.topic] if isinstance(each, Listening) else each for each in listenings]

    @asynccontextmanager
    async def follow(
        self,
        topic: str,
        type_name: str = "",
        *,
        most: int | None = None,  # noqa: ARG002 - those who follow stop by themselves
    ) -> AsyncGenerator[Stream, None]:
        """Every sample from now on; waits for the topic to appear."""
        asked_at = monotonic()
        async with self._robot.listen(topic, type_name, wait_s=self._duration_s) as heard:
            deadline = (monotonic() if self._whole else asked_at) + self._duration_s
            qos = heard.choice.qos
            async with aclosing(_batches(heard, deadline)) as batches:
                yield Stream(
                    heard.topic,
                    heard.type,
                    self.codec,
                    heard.publishers,
                    batches,
                    lambda: heard.counts,
                    lambda last: self._why_no_more(heard, last),
                    lambda: monotonic() - asked_at,
                    f"{qos.reliability}, {qos.durability}: {heard.choice.reason}",
                )

    async def scene(self) -> Scene:
        """The graph now, without ourselves."""
        graph = self._robot.graph
        topics = await graph.topics()
        nodes = await graph.nodes()
        services = await graph.services()
        own = graph.own_nodes
        limit = asyncio.Semaphore(_ASKED_AT_ONCE)

        async def endpoints(topic: str) -> TopicEndpoints:
            async with limit:
                return _without(own, await self._named(topic))

        found = await asyncio.gather(*(endpoints(row.name) for row in topics))
        return Scene(
            {each.topic: each for each in found if each.types},
            sorted(row.name for row in nodes if row.name not in own),
            sorted(row.name for row in services),
            topics.settled and nodes.settled,
        )

    async def _named(self, topic: str) -> TopicEndpoints:
        """The endpoints of a topic; the names of nodes that have only just appeared are waited for, at most 1 s."""
        deadline = monotonic() + _NAMES_S
        found = await self._robot.graph.endpoints(topic)
        while monotonic() < deadline and any(each.node == _UNNAMED for each in (*found.publishers, *found.subscribers)):
            await asyncio.sleep(0.1)
            found = await self._robot.graph.endpoints(topic)
        return found

    async def _why_no_more(self, heard: Listening, last: Sample | None) -> str:
        now = await self._robot.graph.endpoints(heard.topic)
        if last is not None:
            left = len(heard.publishers) - len(now.publishers)
            gone = f" {left} publisher(s) left during the read." if left > 0 else ""
            at = iso_time(last.received_ns)
            return f"The time ended before all the messages came; the last came at {at}.{gone}"
        if not now.publishers:
            return "Nobody publishes on it now." if not heard.publishers else "Its publisher left during the read."
        if heard.type not in {publisher.type for publisher in now.publishers}:
            return f"It is published with the type {', '.join(now.types)}."
        there = ", ".join(_nodes(now.publishers))
        return f"{len(now.publishers)} publisher(s) there, but no message came while this listened: {there}."

    async def _subscribe(self, subscriptions: AsyncExitStack, topic: str) -> Listening | Missing:
        try:
            return await subscriptions.enter_async_context(self._robot.listen(topic))
        except RobotError as error:
            return Missing(topic, error)

    async def _collect(self, heard: Listening, among: int, times_only: bool, report: Report) -> _Kept:
        kept = _Kept(MAX_BYTES // among, times_only)
        started = monotonic()
        while (left := started + self._duration_s - monotonic()) > 0:
            kept.add(await heard.take(min(left, _TURN_S)))
            elapsed = monotonic() - started
            if elapsed > _TURN_S:
                await report(elapsed, self._duration_s, f"{heard.topic}: {len(kept.samples)} messages")
        return kept

    def _window(self, heard: Listening, kept: _Kept, start_ns: int, end_ns: int) -> Window:
        latched = heard.choice.qos.durability == "transient_local"
        earliest_ns = 0 if latched else start_ns
        samples = [each for each in kept.samples if earliest_ns <= each.received_ns <= end_ns]
        counts = heard.counts
        dropped = kept.dropped + counts.dropped
        publishers = _nodes(heard.publishers)
        return Window(
            heard.topic,
            heard.type,
            self.codec,
            samples,
            start_ns,
            end_ns,
            len(samples) + dropped,
            dropped,
            counts.lost,
            publishers,
            self.words,
        )


class _Kept:
    """Samples within a bound on their bytes; the oldest are dropped and counted."""

    def __init__(self, max_bytes: int, times_only: bool) -> None:
        self.samples: deque[Sample] = deque()
        self.dropped = 0
        self._bytes = 0
        self._max_bytes = max_bytes
        self._times_only = times_only

    def add(self, samples: Sequence[Sample]) -> None:
        for sample in samples:
            self.samples.append(replace(sample, data=b"") if self._times_only else sample)
            self._bytes += 0 if self._times_only else len(sample.data)
        while len(self.samples) > MAX_SAMPLES or (self._bytes > self._max_bytes and len(self.samples) > 1):
            self._bytes -= len(self.samples.popleft().data)
            self.dropped += 1


async def _matched(listenings: Sequence[Listening]) -> None:
    """Waits, at most half a second, until a message has come on every topic that has a publisher."""
    deadline = monotonic() + _MATCHING_S
    while monotonic() < deadline and not all(each.counts.received for each in listenings if each.publishers):
        await asyncio.sleep(0.01)


async def _batches(heard: Listening, deadline: float) -> AsyncGenerator[Sequence[Sample], None]:
    while (left := deadline - monotonic()) > 0:
        yield await heard.take(min(left, _TURN_S))
    yield await heard.take(0.0)


def _nodes(publishers: Sequence[Endpoint]) -> list[str]:
    return sorted({publisher.node for publisher in publishers})


def _without(nodes: Collection[str], present: TopicEndpoints) -> TopicEndpoints:
    return TopicEndpoints(
        present.topic,
        [each for each in present.publishers if each.node not in nodes],
        [each for each in present.subscribers if each.node not in nodes],
    )
