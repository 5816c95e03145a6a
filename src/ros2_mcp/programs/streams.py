"""The topics that a program follows, live or recorded: messages are kept at full rate until the program
requests them.
"""

from __future__ import annotations

import asyncio
import math
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from time import monotonic
from typing import TYPE_CHECKING, Any

from ros2_mcp.model import names
from ros2_mcp.model.aside import aside
from ros2_mcp.model.errors import BadData, Refused, RobotError, TimedOut
from ros2_mcp.model.interfaces import OCTETS, FieldType
from ros2_mcp.model.samples import Sample
from ros2_mcp.model.text import named
from ros2_mcp.ops.actions.send_goal import follow
from ros2_mcp.ops.sources.source import Source, Stream
from ros2_mcp.programs.crossing import MOST_NUMBERS
from ros2_mcp.programs.held import Held
from ros2_mcp.robot import Robot
from ros2_mcp.robot.goals import Goal

if TYPE_CHECKING:
    from ros2_mcp.values.render import RenderOptions

MOST_WAITING = 1000
"""The most messages of one topic that wait for the program: ten seconds at 100 Hz. Of a live topic the oldest are
dropped, and counted.
"""
MOST_WAITING_BYTES = 16_000_000
"""The same limit in bytes: five raw camera images."""
MOST_BYTES = 2_000_000
"""The largest message that is passed whole. Of a larger one, the large arrays stay in this process, and the program
gets references.
"""
_LARGE_ARRAY = 10_000
"""The least number of elements of an array that stays in this process, in a message larger than that."""
MOST_STREAMS = 16
"""The most streams at the same time; `sandbox.STREAMS` objects represent them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FollowRequest:
    """The settings of a stream: `fields` as in `ros2_topic_subscribe`; at most `count` messages; every `every_n`-th
    message.
    """

    topics: Sequence[str]
    fields: Sequence[str] = ()
    count: int | None = None
    every_n: int = 1


class Followed:
    """One or several topics, followed until `close`.

    Live messages wait in the order of receipt, at most `keep` of each topic. Those of a recording are read when the
    program requests them, with the topics merged by time.
    """

    def __init__(
        self,
        source: Source,
        wanted: FollowRequest,
        held: Held,
        *,
        keep: int = MOST_WAITING,
        limit: int | None = None,
    ) -> None:
        self._source = source
        self._held = held
        self._wanted = wanted
        self._keep = keep
        self._given = 0
        self._changed = asyncio.Event()
        self._has_room = asyncio.Event()
        self._topics = [_Topic(_name_in(source, topic)) for topic in wanted.topics]
        self._tasks = [asyncio.create_task(self._follow(topic, limit)) for topic in self._topics]

    async def opened(self) -> None:
        """Wait until every topic is followed. Raises as `Source.follow` if one cannot be."""
        while not all(topic.stream or topic.is_over for topic in self._topics):
            await self._wait(math.inf)
        for topic in self._topics:
            if topic.error:
                raise topic.error

    async def next(self, timeout_s: float = math.inf) -> dict[str, Any] | None:
        """Return the next message, or None after the last message. Waits as long as the source lasts.

        Raises:
            TimedOut: if no message came in that time.
            RobotError: the error that ended a topic.
        """
        if self._wanted.count is not None and self._given >= self._wanted.count:
            return None
        deadline = monotonic() + timeout_s
        while (topic := self._ready()) is None:
            if all(each.is_over for each in self._topics):
                for each in self._topics:
                    if each.error:
                        raise each.error
                return None
            if (left_s := deadline - monotonic()) <= 0:
                raise TimedOut(f"No message on {', '.join(named(each.name) for each in self._topics)}.")
            await self._wait(left_s)
        self._given += 1
        sample = topic.take()
        self._has_room.set()
        return await self._told(topic, sample)

    async def newest(self, timeout_s: float) -> dict[str, Any]:
        """Return the newest message, without removing it. Raises as `next`."""
        deadline = monotonic() + timeout_s
        topic = self._topics[0]
        while topic.last is None:
            if topic.error:
                raise topic.error
            left_s = deadline - monotonic()
            if topic.is_over or left_s <= 0:
                why = f" {await topic.stream.why_no_more(None)}" if topic.stream else ""
                raise TimedOut(f"No message on {named(topic.name)}.{why}")
            await self._wait(left_s)
        return await self._told(topic, topic.last)

    async def close(self) -> None:
        """End the subscriptions."""
        for task in self._tasks:
            task.cancel()
        if self._tasks:
            await asyncio.wait(self._tasks)

    async def _follow(self, topic: _Topic, limit: int | None) -> None:
        try:
            async with self._source.follow(topic.name, limit=limit, every_n=self._wanted.every_n) as stream:
                topic.stream = stream
                topic.check(self._wanted.fields)
                self._changed.set()
                async for batch in stream.batches:
                    for sample in batch:
                        while not self._source.is_live and topic.is_full(self._keep):
                            self._has_room.clear()
                            await self._has_room.wait()
                        topic.put(sample, self._keep)
                    if batch:
                        self._changed.set()
        except RobotError as error:
            topic.error = error
        finally:
            topic.is_over = True
            self._changed.set()

    def _ready(self) -> _Topic | None:
        """Return the topic with the next message; None while that is unknown."""
        if not self._source.is_live and any(not each.waiting and not each.is_over for each in self._topics):
            return None
        waiting = [each for each in self._topics if each.waiting]
        return min(waiting, key=lambda each: each.waiting[0].received_ns) if waiting else None

    async def _wait(self, timeout_s: float) -> None:
        self._changed.clear()
        with suppress(asyncio.TimeoutError):
            await asyncio.wait_for(self._changed.wait(), None if timeout_s == math.inf else timeout_s)

    async def _told(self, topic: _Topic, sample: Sample) -> dict[str, Any]:
        """Return a message as the program gets it: its fields, or the requested fields, and `_topic`, `_time` and the
        like.
        """
        stream = topic.stream
        assert stream
        value = await aside(len(sample.data), _values, stream, sample, tuple(self._wanted.fields), self._held)
        value["_topic"] = topic.name
        value["_time"] = sample.received_ns / 1e9
        if self._source.is_live:
            value["_age_s"] = round(max(0.0, (stream.end_ns - (sample.source_ns or sample.received_ns)) / 1e9), 6)
            if stream.is_replayed(sample):
                value["_from_before"] = True
        value["_dropped"] = topic.dropped + stream.counts.dropped
        return value


class FollowedGoal:
    """The feedback of one goal until the goal has ended; empty if no server accepted the goal."""

    def __init__(self, robot: Robot, goal: Goal | None) -> None:
        self._waiting: deque[dict[str, Any]] = deque(maxlen=MOST_WAITING)
        self._changed = asyncio.Event()
        self._task = asyncio.create_task(follow(robot, goal, heard=self._hear)) if goal else None
        if self._task:
            self._task.add_done_callback(lambda _: self._changed.set())

    def _hear(self, feedback: Mapping[str, Any]) -> None:
        self._waiting.append(dict(feedback))
        self._changed.set()

    async def next(self) -> dict[str, Any] | None:
        """Return the next feedback, or None when the goal has ended. Raises `NotFound` if the action server
        has left.
        """
        while not self._waiting:
            if not self._task:
                return None
            if self._task.done():
                self._task.result()
                return None
            self._changed.clear()
            await self._changed.wait()
        return self._waiting.popleft()

    async def close(self) -> None:
        """Stop following; the goal itself continues."""
        if self._task:
            self._task.cancel()
            await asyncio.wait({self._task})
            if not self._task.cancelled():
                self._task.exception()  # retrieved, so that asyncio does not log it


class _Topic:
    """One followed topic: its waiting samples, the last sample, and the number of dropped samples."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.stream: Stream | None = None
        self.waiting: deque[Sample] = deque()
        self.last: Sample | None = None
        self.error: RobotError | None = None
        self.is_over = False
        self.dropped = 0
        self._bytes = 0

    def check(self, fields: Sequence[str]) -> None:
        """Raise `BadValue` if the type of the topic lacks a field."""
        if fields and self.stream:
            from ros2_mcp.values.select import parse_fields

            parse_fields(self.stream.codec.definitions, self.stream.type, fields)

    def is_full(self, keep: int) -> bool:
        """Return whether another sample would displace a waiting sample."""
        return len(self.waiting) >= keep or (bool(self.waiting) and self._bytes > MOST_WAITING_BYTES)

    def put(self, sample: Sample, keep: int) -> None:
        self.last = sample
        if keep <= 1:  # only the last one is needed
            return
        while self.is_full(keep):
            self._bytes -= len(self.waiting.popleft().data)
            self.dropped += 1
        self.waiting.append(sample)
        self._bytes += len(sample.data)

    def take(self) -> Sample:
        sample = self.waiting.popleft()
        self._bytes -= len(sample.data)
        return sample


class Streams:
    """All topics that one program follows, and the large arrays of its messages; closed together with the program."""

    def __init__(self) -> None:
        self.held = Held()
        self._followed: dict[int, Followed | FollowedGoal] = {}
        self._latest: dict[tuple[str, tuple[str, ...]], Followed] = {}
        self._count = 0

    async def follow(self, source: Source, wanted: FollowRequest) -> int:
        """Begin to follow topics. Return the number with which `next` gets their messages.

        Raises:
            Refused: if the program follows too many topics already.
            RobotError: as `Source.follow`.
        """
        number = self._free()
        limit = wanted.count if len(wanted.topics) == 1 and not source.is_live else None
        followed = self._followed[number] = Followed(source, wanted, self.held, limit=limit)
        await followed.opened()
        self._count += 1
        return number

    def follow_goal(self, robot: Robot, goal: Goal | None) -> int:
        """Begin to follow the feedback of a goal. Return the number for `next`. Raises `Refused` as `follow`."""
        number = self._free()
        self._followed[number] = FollowedGoal(robot, goal)
        return number

    def _free(self) -> int:
        if len(self._followed) + len(self._latest) >= MOST_STREAMS:
            raise Refused(
                f"A program can have at most {MOST_STREAMS} open streams.",
                "Call messages() once, before the loop, not in it.",
            )
        return next(number for number in range(MOST_STREAMS) if number not in self._followed)

    async def next(self, number: int) -> dict[str, Any] | None:
        """Return the next message of a stream, or None at its end; the end closes the stream. Raises as
        `Followed.next`.
        """
        if (followed := self._followed.get(number)) is None:
            return None
        message = await followed.next()
        if message is None:
            del self._followed[number]
            await followed.close()
        return message

    async def latest(self, source: Source, topic: str, fields: Sequence[str], timeout_s: float) -> dict[str, Any]:
        """Return the newest message of a topic; the topic is followed from the first call on. Raises as
        `Followed.newest`.
        """
        key = _name_in(source, topic), tuple(fields)
        followed = self._latest.get(key)
        if followed is None:
            if len(self._followed) + len(self._latest) >= MOST_STREAMS:
                await self._latest.pop(next(iter(self._latest))).close()
            followed = Followed(source, FollowRequest(topics=[topic], fields=fields), self.held, keep=1)
            self._latest[key] = followed
        try:
            return await followed.newest(timeout_s)
        except RobotError:
            self._latest.pop(key, None)
            await followed.close()
            raise

    async def close(self) -> None:
        """Close all streams."""
        followed = [*self._followed.values(), *self._latest.values()]
        self._followed, self._latest = {}, {}
        await asyncio.gather(*(each.close() for each in followed), return_exceptions=True)


def _name_in(source: Source, topic: str) -> str:
    """Return the absolute name of a live topic; that of a recorded topic as it is. Raises `BadName` for an invalid
    name.
    """
    return names.absolute(topic) if source.is_live else topic.strip()


def _values(stream: Stream, sample: Sample, fields: tuple[str, ...], held: Held) -> dict[str, Any]:
    """Return a message as a program gets it. Raises `Refused` if it is too large even without its large arrays."""
    from ros2_mcp.values.render import RenderOptions, render

    size = len(sample.data)
    least = _LARGE_ARRAY if size > MOST_BYTES else MOST_NUMBERS
    held_bytes = 0

    def hold(kind: FieldType, array: Any) -> Any:
        nonlocal held_bytes
        if len(array) <= least or (kind.base in OCTETS and size <= MOST_BYTES):
            return None
        held_bytes += array.nbytes
        return held.reference(array, str(kind))

    options: RenderOptions = RenderOptions(native=True, fields=fields or None, hold=None if fields else hold)
    definitions = stream.codec.definitions
    try:
        message = stream.codec.decode(stream.type, sample.data)
    except BadData as error:
        raise BadData(f"A message of {named(stream.topic)} is not what its type says: {error.message}") from error
    value = render(definitions, stream.type, message, options=options).value
    if size - held_bytes > MOST_BYTES and not fields:
        raise Refused(
            f"A message of {named(stream.topic)} has {size} bytes, too large for a program to get whole.",
            "Ask for its fields.",
        )
    return value
