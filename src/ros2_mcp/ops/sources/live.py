"""The live robot as a source of samples."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Sequence
from contextlib import AsyncExitStack, aclosing, asynccontextmanager
from copy import copy
from dataclasses import dataclass, field, replace
from time import monotonic
from typing import TYPE_CHECKING

from ros2_mcp.guard.policy import bounded
from ros2_mcp.model import names
from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.pictures import COMPRESSED_IMAGE, IMAGE
from ros2_mcp.model.qos import Endpoint
from ros2_mcp.model.samples import STAMP_END, Counts, Sample
from ros2_mcp.model.text import counted, listed
from ros2_mcp.ops.memory.bag_store import BagStore
from ros2_mcp.ops.nodes.own_services import ask_node, service_of
from ros2_mcp.ops.results.results import Report, iso_time, reporting, silent
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
from ros2_mcp.robot.seen import is_of_robot
from ros2_mcp.robot.transforms import TransformListener
from ros2_mcp_common.wire.limits import MAX_DURATION_S

if TYPE_CHECKING:
    from ros2_mcp.values.cdr import Codec

_MATCHING_S = 0.5
"""Time for matching, which takes 20 to 200 ms on one host; topics slower than 2 Hz would only delay the others."""
_PROMPT_S = 0.002
"""The delay of messages in the bridge for prompt readers: as short as the bridge allows."""
_BURST_NS = 1_000_000_000
"""The messages that publishers keep for late subscribers come at once when they match;
even large maps within a second."""
_STREAM_MESSAGES, _STREAM_NS = 5, 1_500_000_000
"""A topic with so many messages over such a time is a stream: its silence later in the session is reported; a single
press of a button is not.
"""
_TURN_S = 1.0
"""The longest single wait for samples; the empty batch after it shows that the stream is alive."""
_APPEARING_S = 1.0
"""Time for a topic without a similar name in the graph: its publisher may be starting; discovery on one machine takes
less.
"""
_QUESTION = "rcl_interfaces/srv/GetParameterTypes"
_ANSWER_S = 1.0
"""Time-out of a question to a node: a node that spins answers within milliseconds, also over a wireless network."""
_REPAIRED_S = 4.0
"""Discovery repairs within 3 s what it lost of a node that has just started, its answer and its
messages; then the bridge asks again."""
_ASKED_NODES, _AT_A_TIME = 20, 5
"""The most nodes that are asked, and how many at a time: one answer is enough, and the questions should not load the
robot. Some nodes never answer, because nothing spins them; but not that many."""
MAX_BYTES = 192_000_000
"""The most bytes of all topics that are measured together: a minute of a raw camera at 3 MB/s, and
affordable on a robot's computer."""
MAX_SAMPLES = 200_000
"""The most samples of one topic: an IMU at 1 kHz for three minutes."""
_TURN_SAMPLES = 200
"""Samples that a thread decodes in one go: some 10 ms, so that a cancelled call ends at once."""
_MAX_NAMED = 6
"""The most publishers in a sentence; the result lists all nodes."""
_OF_MANY = frozenset(
    {
        "diagnostic_msgs/msg/DiagnosticArray",
        "rcl_interfaces/msg/Log",
        "rcl_interfaces/msg/ParameterEvent",
        "tf2_msgs/msg/TFMessage",
    }
)
"""Types whose messages name their origin themselves, so that several publishers are normal."""
_ASKED_AT_ONCE = 32
"""Questions to the bridge at the same time; it answers one after the other."""


@dataclass(kw_only=True)
class _LiveStream(Stream):
    """A subscription. The call that made it began at the monotonic time `asked_at`, waiting for the topic included."""

    robot: Robot
    listening: Listening
    asked_at: float
    _received_ns: tuple[int, int] | None = field(default=None, init=False)
    _least_age_ns: int | None = field(default=None, init=False)
    _first_ns: int = field(default=0, init=False)
    _count: int = field(default=0, init=False)

    def look_at(self, samples: Sequence[Sample]) -> Sequence[Sample]:
        """Learn from samples the offset of the publisher's clock from ours, and whether the topic
        is a stream. Return the samples.
        """
        if samples and not self.thinned:
            self._note_flow(samples)
        for sample in samples if self.is_latched else ():
            first_ns = self._received_ns[0] if self._received_ns else sample.received_ns
            self._received_ns = first_ns, sample.received_ns
            age_ns = sample.received_ns - sample.source_ns
            if sample.source_ns and (self._least_age_ns is None or age_ns < self._least_age_ns):
                self._least_age_ns = age_ns
        return samples

    def _note_flow(self, samples: Sequence[Sample]) -> None:
        new = [sample.received_ns for sample in samples if not self.is_replayed(sample)]
        if not new:
            return
        self._first_ns = self._first_ns or new[0]
        self._count += len(new)
        if self._count >= _STREAM_MESSAGES and new[-1] - self._first_ns >= _STREAM_NS:
            self.robot.graph.seen.note_stream(self.topic)

    @property
    def is_latched(self) -> bool:
        """Return whether the subscription receives earlier messages."""
        return self.listening.choice.qos.durability == "transient_local"

    @property
    def _keeps_coming(self) -> bool:
        """Return whether messages still arrive after the first burst, in which a latched topic replays its kept
        messages.
        """
        return self._received_ns is not None and self._received_ns[1] - self._received_ns[0] > _BURST_NS

    @property
    def tells_replayed(self) -> bool:
        return not self.is_latched or self._keeps_coming

    @property
    def mixed(self) -> str:
        return mixed(self.type, self.publishers)

    @property
    def left_behind(self) -> str:
        left = self.counts.dropped if self.robot.graph.is_remote else 0
        return (
            f"Not received: {counted(left, 'message')}, more than the link to the robot could carry in this time."
            if left
            else ""
        )

    @property
    def counts(self) -> Counts:
        return self.listening.counts

    @property
    def covered_s(self) -> float:
        return monotonic() - self.asked_at

    @property
    def end_ns(self) -> int:
        return self.robot.now_ns()

    def is_replayed(self, sample: Sample) -> bool:
        """Return whether a sample was sent before the subscription, by the publisher's time. If messages keep coming,
        the youngest one shows the offset of its clock.
        """
        if not self.is_latched:
            return False
        off_ns = self._least_age_ns if self._keeps_coming and self._least_age_ns is not None else 0
        return 0 < sample.source_ns < self.asked_ns - off_ns or sample.received_ns < self.start_ns

    async def why_no_more(self, last: Sample | None) -> str:
        if self.left_behind:
            return ""  # it gives the reason
        now = await self.robot.graph.endpoints(self.topic)
        if last is not None:
            left = len(self.publishers) - len(now.publishers)
            gone = f" {counted(left, 'publisher')} left during the read." if left > 0 else ""
            at = iso_time(last.received_ns)
            return f"The time ended before all messages came; the last one came at {at}.{gone}"
        if not now.publishers:
            return "This topic has no publisher now." if not self.publishers else "Its publisher left during the read."
        if self.type not in {publisher.type for publisher in now.publishers}:
            return f"The topic is published with the type {', '.join(now.types)}."
        nodes = ", ".join(sorted({publisher.who for publisher in now.publishers}))
        far = " Give a longer time: large messages take longer over this link." if self.robot.graph.is_remote else ""
        return f"No message came in this time from {counted(len(now.publishers), 'publisher')}: {nodes}.{far}"

    async def take_until(self, deadline: float, *, ends: bool = False) -> AsyncGenerator[Sequence[Sample], None]:
        """Yield the samples that arrive before that monotonic time; with `ends`, the subscription ends then."""
        while (left := deadline - monotonic()) > 0:
            yield self.look_at(await self.listening.take(min(left, _TURN_S)))
        if ends and self.robot.graph.is_remote:  # counts come with samples; those of unsent samples only at the end
            await self.listening.end()
        yield self.look_at(await self.listening.take(0.0))
        if names.UNKNOWN_NODE in {publisher.node for publisher in self.publishers}:  # they had only just appeared
            named = {one.gid: one for one in (await self.robot.graph.endpoints(self.topic)).publishers}
            self.publishers = [named.get(one.gid, one) for one in self.publishers]


class Live(Source):
    """The messages of the robot for `duration_s` from the call on.

    With `whole` that time begins when the topic exists, however long that took; else it includes the wait for the
    topic. Unless it `waits`, a topic that does not exist although discovery has settled is an error at once. With
    `judges`, of the messages sent before the subscription only the newest counts: see `judging`.
    """

    title = "the robot"
    is_live = True

    def __init__(
        self,
        robot: Robot,
        duration_s: float = 0.0,
        *,
        whole: bool = False,
        waits: bool = True,
        judges: bool = False,
        report: Report = silent,
    ) -> None:
        bounded("duration", duration_s, 0.0, MAX_DURATION_S, "s")
        self.words = f"live, {duration_s:g} s"
        self.duration_s = duration_s
        self._robot = robot
        self._whole = whole
        self._waits = waits
        self._judges = judges
        self._report = report
        self._drain_s: float | None = None

    @property
    def codec(self) -> Codec:
        """The codec for the robot's messages."""
        return self._robot.values.codec

    def lasting(self, live_s: float, *, recorded_s: float | None = None, whole: bool = False) -> Live:
        """Return the live robot for that time from now on."""
        waits = self._waits or recorded_s is not None
        return Live(self._robot, live_s, whole=whole, waits=waits, judges=self._judges, report=self._report)

    def judging(self) -> Live:
        """Return the same source, but `follow` omits all but the newest of the
        messages that a latched topic replays.
        """
        return Live(
            self._robot, self.duration_s, whole=self._whole, waits=self._waits, judges=True, report=self._report
        )

    def prompt(self) -> Live:
        """Return the same source, but its messages wait less long in the bridge."""
        found = copy(self)
        found._drain_s = _PROMPT_S
        return found

    def words_after(self, took_s: float) -> str:
        """Return the duration of the read, and its limit if that was not reached."""
        return f"live, {took_s:.2g} s of at most {self.duration_s:g} s" if took_s < self.duration_s else self.words

    @property
    def transforms(self) -> TransformListener:
        """The listener of the robot's transforms."""
        return self._robot.transforms

    async def type_of(self, topic: str) -> str:
        """Return the type of a topic that exists now. Raises the same errors as `Source.type_of`."""
        type_name = await self._robot.types.topic(await self._robot.graph.endpoints(names.absolute(topic)), "")
        await self._robot.values.learn(type_name)
        return type_name

    async def captures(
        self, topics: Sequence[str], keep: Keep[K], report: Report = silent, *, times_only: bool = False
    ) -> Sequence[Capture[K] | Missing]:
        """Subscribe to all topics over the same time. It begins when each published topic has sent a message, but at
        most `_MATCHING_S` after the subscriptions.
        """

        head_bytes = STAMP_END if times_only else 0

        async def opened(topic: str) -> _LiveStream | Missing:
            asked_at = monotonic()
            try:
                listening = await subscriptions.enter_async_context(self._robot.listen(topic, head_bytes=head_bytes))
                return self._stream(listening, asked_at)
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
            start_ns, deadline = self._robot.now_ns(), monotonic() + self.duration_s
            for stream in streams:
                stream.start_ns = start_ns
            # By stream, not by topic: one topic may be requested twice, as two captures.
            most_bytes = MAX_BYTES // max(len(streams), 1)
            collectors = {
                id(stream): Collector(max_samples=MAX_SAMPLES, max_bytes=most_bytes, times_only=times_only)
                for stream in streams
            }
            async with reporting(report, self.duration_s, progress):
                await asyncio.gather(*map(collect, streams))
            end_ns = self._robot.now_ns()
        for stream in streams:  # what was received before the end and sent to us after it
            collectors[id(stream)].add(stream.look_at(await stream.listening.take(0.0)))
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
        every_n: int = 1,
        latched: bool = True,  # noqa: ARG002 - the publishers decide
        times_only: bool = False,
    ) -> AsyncGenerator[Stream, None]:
        """Read every sample from now on; wait for the topic to appear."""
        asked_at = monotonic()
        head_bytes = STAMP_END if times_only else 0
        async with self._robot.listen(
            topic,
            type_name,
            wait_s=self.duration_s,
            absent=self._absent,
            head_bytes=head_bytes,
            every_n=every_n,
            newest_of_old=self._judges,
            drain_s=self._drain_s,
        ) as listening:
            stream = self._stream(listening, asked_at)
            stream.thinned = every_n > 1
            stream.batches = stream.take_until((monotonic() if self._whole else asked_at) + self.duration_s, ends=True)
            async with aclosing(stream.batches):
                yield stream

    async def lightest(self, topic: str) -> str:
        """Return, over a network, the topic with the compressed pictures of a camera, if it
        has a publisher; else the topic.
        """
        full = names.absolute(topic)
        if not self._robot.graph.is_remote:
            return topic
        raw, compressed = await asyncio.gather(
            *(self._robot.graph.endpoints(name) for name in (full, f"{full}/compressed"))
        )
        has_both = IMAGE in raw.types and any(one.type == COMPRESSED_IMAGE for one in compressed.publishers)
        return compressed.topic if has_both else topic

    async def publishing(self, *types: str) -> list[str]:
        """Return the published topics with one of these types, as `Source.publishing`. Only topics
        with such a type are looked up.
        """
        graph = self._robot.graph
        rows = [row.name for row in await graph.topics() if not set(types).isdisjoint(row.types)]
        found = await asyncio.gather(*map(graph.endpoints, rows))
        return sorted(one.topic for one in found if any(end.type in types for end in one.publishers))

    async def absence(self) -> str:
        """Return the sentence that no robot is there, as `Source.absence`."""
        return await self._robot.graph.absence()

    async def graph(self) -> GraphSnapshot:
        """Return the present graph, without this server's own nodes."""
        graph = self._robot.graph
        topics = await graph.topics()
        nodes = await graph.nodes()
        services = await graph.services()
        own = graph.own_nodes
        limit = asyncio.Semaphore(_ASKED_AT_ONCE)

        async def endpoints(topic: str) -> TopicEndpoints:
            async with limit:
                present = await self._robot.graph.endpoints(topic)
            return TopicEndpoints(
                topic,
                [publisher for publisher in present.publishers if publisher.node not in own],
                [subscriber for subscriber in present.subscribers if subscriber.node not in own],
            )

        present = await asyncio.gather(*(endpoints(row.name) for row in topics))
        by_name = {found.topic: found for found in present if found.types}
        others = sorted(row.name for row in nodes if row.name not in own)
        return GraphSnapshot(
            by_name,
            others,
            {row.name: row.types for row in sorted(services)},
            topics.settled and nodes.settled,
            absence=await graph.absence(),
            left=graph.seen.left(others, by_name),
            ran=graph.seen.ran,
        )

    async def hung(self, nodes: Sequence[str]) -> Sequence[str]:
        """Return some of these nodes if none of them answers; else empty. The graph shows killed or disconnected nodes
        for another 20 s.
        """
        offered = {row.name for row in await self._robot.graph.services()}
        asked = [node for node in dict.fromkeys(nodes) if is_of_robot(node) and service_of(node, _QUESTION) in offered]
        asked = asked[:_ASKED_NODES]

        async def answers(node: str, within_s: float = _ANSWER_S) -> bool:
            try:
                await ask_node(self._robot, node, _QUESTION, {"names": []}, timeout_s=within_s, wait_s=within_s)
            except RobotError:  # also `NotFound`: a node that hangs never matches a new client
                return False
            return True

        for first in range(0, len(asked), _AT_A_TIME):
            if any(await asyncio.gather(*map(answers, asked[first : first + _AT_A_TIME]))):
                return ()
        again = (answers(node, _REPAIRED_S) for node in asked[:_AT_A_TIME])
        return () if any(await asyncio.gather(*again)) else asked

    async def _absent(self, present: TopicEndpoints) -> None:
        """Report similar names for a topic that does not exist: as an error, or as the
        first progress of a wait for it.
        """
        graph, topic = self._robot.graph, present.topic
        near = await graph.near_topic(topic)
        if self._waits or not present.settled:
            await self._report(0.0, self.duration_s, f"Waiting for the topic {topic}. {near}".rstrip())
            return
        if not near:
            present = await graph.wait_for(topic, publishers=1, timeout_s=_APPEARING_S, present=present)
        if not present.types:
            raise await graph.no_such_topic(topic)

    def _stream(self, listening: Listening, asked_at: float) -> _LiveStream:
        qos = listening.choice.qos
        # Only now: the robot's clock is unknown before its first answer.
        asked_ns = self._robot.now_ns() - round((monotonic() - asked_at) * 1e9)
        return _LiveStream(
            topic=listening.topic,
            type=listening.type,
            codec=self.codec,
            publishers=listening.publishers,
            qos=f"{qos.reliability}, {qos.durability}: {listening.choice.reason}",
            robot=self._robot,
            listening=listening,
            asked_at=asked_at,
            asked_ns=asked_ns,
        )

    async def _capture(
        self, stream: _LiveStream, kept: K, collector: Collector, start_ns: int, end_ns: int
    ) -> Capture[K]:
        """Return what was received between both times; for a latched topic also the earlier messages."""
        earliest_ns = 0 if stream.is_latched else start_ns
        samples = [sample for sample in collector.samples if earliest_ns <= sample.received_ns <= end_ns]
        for begin in range(0, len(samples), _TURN_SAMPLES):
            await asyncio.to_thread(kept.add, samples[begin : begin + _TURN_SAMPLES])
        whole = captured(self, stream, kept, len(samples))
        dropped = whole.dropped + collector.dropped
        return replace(whole, start_ns=start_ns, end_ns=end_ns, received=len(samples) + dropped, dropped=dropped)


def mixed(type_name: str, publishers: Sequence[Endpoint]) -> str:
    """Return a sentence on the publishers whose messages are mixed; empty for one publisher, and for types
    that many nodes usually publish.

    This server's own publishers are not counted: it keeps some that are silent.
    """
    others = [publisher.node for publisher in publishers if not publisher.ours]
    if len(others) < 2 or type_name in _OF_MANY:
        return ""
    return f"{len(others)} publishers ({listed(sorted(others), _MAX_NAMED)}): their messages are mixed."


async def _matched(streams: Sequence[_LiveStream]) -> None:
    """Wait, at most half a second, until a message has come on every topic that has a publisher."""
    deadline = monotonic() + _MATCHING_S
    while monotonic() < deadline and not all(stream.counts.received for stream in streams if stream.publishers):
        await asyncio.sleep(0.01)  # short compared with the 20 ms that matching takes at least


class Robots(SourceKind):
    """The robot of this server as a kind of source."""

    async def named(self, robot: Robot, store: BagStore, request: SourceRequest) -> Source | None:  # noqa: ARG002
        """Return the live robot, if no other source is named."""
        return None if request.name else Live(robot, waits=request.waits, report=request.report)
