"""The WiseVision Data Black Box as a source: a node that keeps messages in InfluxDB and has a service to read them.

Two generations use the same service name; the type of the service shows which one it is.
"""

from __future__ import annotations

import asyncio
import base64
import binascii
import time
from collections.abc import AsyncGenerator, Awaitable, Callable, Mapping, Sequence
from contextlib import aclosing, asynccontextmanager
from dataclasses import dataclass, replace
from datetime import datetime, timedelta, timezone
from typing import TYPE_CHECKING, Any

from ros2_mcp.model import names
from ros2_mcp.model.errors import BadData, BadValue, NotFound, RobotError, TimedOut, UnknownInterface
from ros2_mcp.model.samples import Sample
from ros2_mcp.model.text import quoted
from ros2_mcp.ops.memory.bag_store import BagStore
from ros2_mcp.ops.results.results import iso_time
from ros2_mcp.ops.sources.selection import MAX_MESSAGES
from ros2_mcp.ops.sources.source import ANSWER_S, Source, SourceKind, SourceRequest, Stream, in_batches
from ros2_mcp.ops.sources.times import last_ns_of, parsed_ns
from ros2_mcp.robot import Robot

if TYPE_CHECKING:
    from ros2_mcp.values.cdr import Codec

FIRST_TYPE = "lora_msgs/srv/GetMessages"
SECOND_TYPE = "wisevision_msgs/srv/InfluxGetMessages"
ANY = "any"
NAMES = ("data black box", "data-black-box", "wisevision")
"""The names that select it instead of a bag."""
_SPECIAL = {
    "std_msgs/msg/Int32": "std_msgs/Int32",
    "lora_msgs/msg/MicroPublisher": "lora_msgs/MicroPublisher",
    "lora_msgs/msg/GpsDeviceData": "wisevision_msgs/GpsDevicesPublisher",
    "wisevision_msgs/msg/GpsDevicesPublisher": "wisevision_msgs/GpsDevicesPublisher",
}
"""The first generation's names of the types that it does not keep as bytes."""
_SPECIAL_LISTS = {
    "int32_msgs": "std_msgs/msg/Int32",
    "micro_publisher_data": "lora_msgs/msg/MicroPublisher",
    "gps_devices_data": "lora_msgs/msg/GpsDeviceData",
}
_EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)
_DAY_NS = 86_400 * 10**9
_REACHES_NS = tuple(seconds * 10**9 for seconds in (60, 3600, 86_400, 30 * 86_400))
"""To get the last N messages, these time ranges before the end are requested one after the other, and then all time."""


@dataclass(frozen=True, slots=True)
class Question:
    """A request for messages of a topic, from `start_ns` to `end_ns` (Unix time, both included; None is open).

    The first generation needs `type` except for its special types. Only the second has a `bucket`.
    """

    topic: str
    type: str = ""
    start_ns: int | None = None
    end_ns: int | None = None
    bucket: str = ""


@dataclass(frozen=True, slots=True)
class Answered:
    """Messages as CDR in the order of time. `type` is "" if the box does not return it. `problem` is an error text."""

    type: str = ""
    samples: Sequence[Sample] = ()
    problem: str = ""


@dataclass(frozen=True, slots=True)
class DataBlackBox:
    """A Data Black Box in the graph."""

    robot: Robot
    service: str
    service_type: str

    @property
    def generation(self) -> int:
        """The generation, 1 or 2."""
        return 1 if self.service_type == FIRST_TYPE else 2

    async def last(self, question: Question, number: int) -> Answered:
        """Return the last `number` messages of the requested time; all of them if `number` is 0.

        The box itself would return the first ones. So all messages of a time that reaches further and further back are
        requested, until there are enough.

        Raises:
            RobotError: with the box's own error text.
        """
        end_ns = question.end_ns or self.robot.now_ns()
        for reach_ns in _REACHES_NS if number else ():
            start_ns = end_ns - reach_ns
            if question.start_ns is not None and start_ns <= question.start_ns:
                break
            answered = await self.answer(replace(question, start_ns=start_ns))
            if len(answered.samples) >= number:
                return replace(answered, samples=answered.samples[-number:])
        answered = await self.answer(question)
        return replace(answered, samples=answered.samples[-number:] if number else answered.samples)

    async def answer(self, question: Question) -> Answered:
        """Return all messages of the requested time. Raises as `last`."""
        for request in requests(question, self.generation):
            answered = await asyncio.to_thread(self._read, await self._inquire(request))
            if answered.samples or answered.problem:
                # The box does not compare fractions of a second exactly. A time of 0 means that it returned none.
                start_ns, end_ns = question.start_ns or 0, question.end_ns or 2**63
                times = range(start_ns, end_ns + 1)
                inside = [one for one in answered.samples if one.received_ns == 0 or one.received_ns in times]
                return replace(answered, samples=inside)
        return Answered()

    async def _inquire(self, request: Mapping[str, Any]) -> bytes:
        try:
            answer = await self.robot.ask_service(
                self.service, self.service_type, request, timeout_s=ANSWER_S, wait_s=1.0
            )
        except TimedOut as error:
            raise TimedOut(error.message, "Ask the Data Black Box for a shorter time.") from error
        except NotFound as error:  # the box has left, which does not mean that it lacks the topic
            raise RobotError(error.message, error.hint) from error
        return answer.body

    def _read(self, body: bytes) -> Answered:
        response: Any = self.robot.values.codec.decode(f"{self.service_type}_Response", body)
        # The first generation never sets `success`: only its message reports an error.
        failed = response.error_message and (self.generation == 1 or not response.success)
        if failed or (self.generation == 2 and not response.success and not len(response.messages)):
            words = quoted(response.error_message) if response.error_message else "it failed without a reason"
            raise RobotError(f"The Data Black Box reported an error: {words}")
        return read_second(response) if self.generation == 2 else self._read_first(response)

    def _read_first(self, response: Any) -> Answered:
        for field, kind in _SPECIAL_LISTS.items():
            values = getattr(response, field)
            if len(values):
                bodies = [self._encoded(kind, value) for value in values]
                return _timed(kind, bodies, response.timestamps)
        bodies, problem = split_payload(bytes(response.data))
        answered = _timed("", bodies, response.timestamps)
        return replace(answered, problem=" ".join(filter(None, (problem, answered.problem))))

    def _encoded(self, kind: str, value: Any) -> bytes:
        if kind == "std_msgs/msg/Int32":
            return b"\x00\x01\x00\x00" + int(value).to_bytes(4, "little", signed=True)
        return self.robot.values.codec.encode(kind, value)


class DataBlackBoxSource(Source):
    """The messages that a Data Black Box has between two Unix times in ns, both included (None is open)."""

    keeps_types = False

    def __init__(self, box: DataBlackBox, start_ns: int | None, end_ns: int | None, bucket: str = "") -> None:
        self.title = f"the WiseVision Data Black Box (generation {box.generation}, {box.service})"
        self.words = f"{self.title}, from {iso_time(start_ns) if start_ns else 'the beginning'} on"
        # Without a start, the source begins with the first message of the box, whose time is unknown: 0 means unknown.
        self.duration_s = 0.0 if start_ns is None else ((end_ns or box.robot.now_ns()) - start_ns) / 1e9
        self._box = box
        self._start_ns = start_ns
        self._end_ns = end_ns
        self._bucket = bucket

    def lasting(self, live_s: float, *, recorded_s: float | None = None, whole: bool = False) -> DataBlackBoxSource:  # noqa: ARG002
        """Limit the source to `recorded_s`: to its beginning if a start was given, otherwise to its end."""
        if recorded_s is None:
            return self
        length_ns = max(round(recorded_s * 1e9), 1)
        end_ns = self._box.robot.now_ns() if self._end_ns is None else self._end_ns
        if self._start_ns is None:
            return DataBlackBoxSource(self._box, end_ns - length_ns, end_ns, self._bucket)
        return DataBlackBoxSource(self._box, self._start_ns, min(end_ns, self._start_ns + length_ns), self._bucket)

    def from_beginning(self) -> DataBlackBoxSource:
        """Return the source without a start."""
        return DataBlackBoxSource(self._box, None, self._end_ns, self._bucket)

    @property
    def codec(self) -> Codec:
        """The codec of its messages, which uses the robot's definitions."""
        return self._box.robot.values.codec

    async def type_of(self, topic: str) -> str:
        """Return the current type of the topic in the graph; the box returns types only with messages."""
        kind = await self._type_now(names.absolute(topic))
        if not kind:
            raise NotFound(f"{names.absolute(topic)} is not published now, so its type is unknown.")
        await self._box.robot.values.learn(kind)
        return kind

    @asynccontextmanager
    async def follow(
        self,
        topic: str,
        type_name: str = "",
        *,
        limit: int | None = None,
        every_n: int = 1,
        latched: bool = True,  # noqa: ARG002 - the box does not keep QoS
        times_only: bool = False,  # noqa: ARG002 - it gives whole messages only
    ) -> AsyncGenerator[Stream, None]:
        """Return the messages of a topic; with a limit, the last messages.

        Raises:
            UnknownInterface: if there are messages whose type is unknown.
            RobotError: with the box's own error text.
        """
        topic = names.absolute(topic)
        expected = names.interface_type(type_name, "msg") if type_name else await self._type_now(topic)
        question = Question(topic, expected, self._start_ns, self._end_ns, self._bucket)
        most = (limit or 0) * every_n  # the box cannot thin them out: the reader does
        answered = await self._box.last(question, most if most < MAX_MESSAGES else 0)
        kind = answered.type or expected
        if answered.samples and not kind:
            raise UnknownInterface(
                f"The Data Black Box has {len(answered.samples)} messages of {topic}, but does not say their type.",
                "Give message_type, such as sensor_msgs/msg/LaserScan.",
            )
        if kind:
            await self._box.robot.values.learn(kind)
        unconfirmed = "" if answered.type else f"The Data Black Box stores no types; the messages were read as {kind}."
        stream = Stream(
            topic=topic,
            type=kind,
            codec=self.codec,
            publishers=(),
            start_ns=self._start_ns or min((sample.received_ns for sample in answered.samples), default=0),
            until_ns=self._end_ns or self._box.robot.now_ns(),
            from_end=bool(limit),
            received=len(answered.samples),
            note=" ".join(filter(None, (answered.problem, unconfirmed if answered.samples else ""))),
        )
        stream.batches = in_batches(answered.samples[-most:])
        stream.further = answered.samples[-most - 1] if 0 < most < len(answered.samples) else None
        async with aclosing(stream.batches):
            yield stream

    async def _type_now(self, topic: str) -> str:
        present = await self._box.robot.graph.endpoints(topic)
        return present.types[0] if len(present.types) == 1 else ""


class DataBlackBoxes(SourceKind):
    """The kind of source for the Data Black Box in the graph, of both generations."""

    async def named(self, robot: Robot, store: BagStore, request: SourceRequest) -> Source | None:  # noqa: ARG002
        """Return the box in the graph if the request names it; None for other names."""
        if request.name.lower() not in NAMES:
            return None
        found = await self._found(robot, request)
        if found is None:
            raise NotFound("There is no Data Black Box in the graph.", f"It has a service of type {SECOND_TYPE}.")
        return found

    async def kept(
        self,
        robot: Robot,
        store: BagStore,  # noqa: ARG002
        request: SourceRequest,
    ) -> Sequence[Callable[[], Awaitable[Source]]]:
        """Return a function that opens the box in the graph, if there is one."""
        found = await self._found(robot, request)

        async def opened() -> Source:
            assert found
            return found

        return [opened] if found else []

    async def _found(self, robot: Robot, request: SourceRequest) -> DataBlackBoxSource | None:
        box = None if robot.policy.recorded else await find_box(robot)
        if box is None:
            return None
        now_ns = robot.now_ns()
        start_name, end_name = request.names
        start_ns = parsed_ns(start_name, request.start, None, now_ns) if request.start else None
        end_ns = parsed_ns(end_name, request.end, None, now_ns) if request.end else None
        if start_ns is not None and end_ns is not None and end_ns < start_ns:
            raise BadValue(end_name, f"{request.end!r} is before {request.start!r}.")
        end_ns = None if end_ns is None else last_ns_of(request.end, end_ns)
        return DataBlackBoxSource(box, start_ns, end_ns, request.bucket)


async def find_box(robot: Robot) -> DataBlackBox | None:
    """Return the Data Black Box in the graph: preferably the box at `/get_messages`, and the second generation before
    the first.
    """
    found = [
        (row.name != "/get_messages", kind != SECOND_TYPE, row.name, kind)
        for row in await robot.graph.services()
        for kind in row.types
        if kind in (FIRST_TYPE, SECOND_TYPE)
    ]
    return DataBlackBox(robot, *min(found)[2:]) if found else None


def requests(question: Question, generation: int) -> list[Mapping[str, Any]]:
    """Return the requests to try until one finds messages.

    The first generation knows topics without their leading slash only. A time range has both ends or none.
    """
    start, end = time_range(question)
    common = {"time_start": start, "time_end": end, "number_of_msgs": 0}
    bare = question.topic.lstrip("/")
    if generation == 2:
        return [{"topic_name": topic, "bucket_name": question.bucket, **common} for topic in (question.topic, bare)]
    special = _SPECIAL.get(question.type)
    kinds = [special, ANY] if special else [ANY]
    return [{"topic_name": bare, "message_type": kind, **common} for kind in kinds]


def time_range(question: Question) -> tuple[dict[str, int], dict[str, int]]:
    """Return the start and the end as the box expects them. An open start becomes the epoch, an open end tomorrow.

    If both are open, both are empty, which the box reads as no limit.
    """
    if question.start_ns is None and question.end_ns is None:
        return {}, {}
    start_ns = 0 if question.start_ns is None else question.start_ns
    end_ns = time.time_ns() + _DAY_NS if question.end_ns is None else question.end_ns
    return full_date_time(start_ns), full_date_time(end_ns)


def full_date_time(unix_ns: int) -> dict[str, int]:
    """Return a Unix time in ns as a `lora_msgs/msg/FullDateTime`, in UTC."""
    seconds, nanosecond = divmod(unix_ns, 10**9)
    date = _EPOCH + timedelta(seconds=seconds)
    parts = ("year", "month", "day", "hour", "minute", "second")
    return {**{part: getattr(date, part) for part in parts}, "nanosecond": nanosecond}


def unix_ns(date: Any) -> int:
    """Return the Unix time in ns of a `FullDateTime`; 0 if it is not a date, such as all zeros."""
    try:
        parts = (date.year, date.month, date.day, date.hour, date.minute, date.second)
        since = datetime(*map(int, parts), tzinfo=timezone.utc) - _EPOCH
    except ValueError:
        return 0
    return (since.days * 86_400 + since.seconds) * 10**9 + int(date.nanosecond)


def split_payload(data: bytes) -> tuple[list[bytes], str]:
    """Split `[uint32 big-endian length][that many bytes]…` into messages. Also return the error at its end, or ""."""
    bodies: list[bytes] = []
    at = 0
    while at < len(data):
        end = at + 4 + int.from_bytes(data[at : at + 4], "big")
        if at + 4 > len(data) or end > len(data):
            return bodies, f"The answer of the Data Black Box is truncated in message {len(bodies) + 1}."
        bodies.append(data[at + 4 : end])
        at = end
    return bodies, ""


def read_second(response: Any) -> Answered:
    """Return the messages of the second generation, which are CDR in base64.

    Raises:
        BadData: if they are not base64.
    """
    try:
        bodies = [base64.b64decode(text, validate=True) for text in response.messages]
    except (binascii.Error, ValueError) as error:
        raise BadData(f"The Data Black Box sent a message that is not base64: {error}.") from error
    kind = names.interface_type(response.message_type, "msg") if response.message_type else ""
    return _timed(kind, bodies, response.timestamps)


def _timed(kind: str, bodies: Sequence[bytes], dates: Sequence[Any]) -> Answered:
    times = [unix_ns(date) for date in dates[: len(bodies)]]
    problem = ""
    if len(dates) != len(bodies):
        problem = f"The Data Black Box returned {len(dates)} times for {len(bodies)} messages."
        times += [0] * (len(bodies) - len(times))
    samples = [Sample(at_ns, 0, None, body) for at_ns, body in zip(times, bodies, strict=True)]
    return Answered(kind, samples if problem else sorted(samples, key=lambda sample: sample.received_ns), problem)
