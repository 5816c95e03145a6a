"""What was said earlier: messages of a topic from whichever source has them."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import TYPE_CHECKING, Any

from ros2_mcp.guard.policy import bounded
from ros2_mcp.model import names
from ros2_mcp.model.errors import BadData, BadName, BadValue, NotFound, RobotError, UnknownInterface
from ros2_mcp.model.samples import Sample
from ros2_mcp.ops.bags import codec_of, definitions_of, find_topic, rendered_within, span_in, taken, times_of
from ros2_mcp.ops.black_box import BLACK_BOX
from ros2_mcp.ops.data_black_box import ANY, TIMEOUT_S, DataBlackBox, Question, find_box
from ros2_mcp.ops.memory import Memory
from ros2_mcp.ops.moments import is_relative, last_ns_of, moment_ns
from ros2_mcp.ops.reading import View
from ros2_mcp.ops.recording import recordings
from ros2_mcp.ops.results import Report, exact_time, iso_time, reporting, silent
from ros2_mcp.robot import Robot

if TYPE_CHECKING:
    from ros2_mcp.codec.cdr import Codec

MAX_MESSAGES = 100_000


@dataclass(frozen=True, slots=True)
class Asked:
    """Which messages: the last `number` of the time between two moments; 0 is all of them, and so is no moment."""

    topic: str
    type: str = ""
    number: int = 0
    start: str = ""
    end: str = ""
    bucket: str = ""


@dataclass(frozen=True, slots=True)
class Found:
    """What one source has, the oldest first."""

    source: str
    type: str
    samples: Sequence[Sample]
    codec: Codec
    note: str = ""


@dataclass(frozen=True, slots=True)
class StoredMessages:
    """Messages of the past with the times at which they were stored (empty where the source does not say).

    `count` are shown of `found` ones; `note` tells if there are earlier ones that were not read. `truncated` names
    paths whose values are summaries.
    """

    source: str
    topic_name: str
    topic_type: str
    timestamps: Sequence[str]
    messages: Sequence[dict[str, Any]]
    count: int
    found: int
    truncated: Sequence[str]
    note: str

    def summary(self) -> str:
        """One line."""
        return f"{self.topic_name}: {self.count} of {self.found} message(s) from {self.source}. {self.note}".rstrip()


async def get_messages(
    robot: Robot, memory: Memory, asked: Asked, view: View, report: Report = silent
) -> StoredMessages:
    """Messages of the past, from the first source that has some.

    If they do not fit, they are evenly thinned; if a number is asked for, the newest of them are shown.

    Raises:
        NotFound: if no source knows the topic.
        BadValue: if a limit or a moment is out of range, or a field is not in the type.
        BadData: if no message is what the type says.
        RobotError: with the words of a source that failed, where no other has the messages.
    """
    bounded("number_of_messages", asked.number, 0, MAX_MESSAGES, "messages")
    bounded("every_n", view.every_n, 1, 1_000_000, "messages")
    kind = "" if asked.type in ("", ANY) else names.interface_type(asked.type, "msg")
    asked = replace(asked, topic=names.absolute(asked.topic), type=kind)
    async with reporting(report, TIMEOUT_S, f"looking for earlier messages of {asked.topic}"):
        found, failed = await _find(robot, memory, asked)
    if found and (found.samples or not failed):
        return await asyncio.to_thread(_show, asked, view, found, failed)
    raise failed[0] if failed else _nobody(asked)


async def _find(robot: Robot, memory: Memory, asked: Asked) -> tuple[Found | None, list[RobotError]]:
    """What the first source has that has messages, else what one without any says; and which sources failed."""
    empty: Found | None = None
    failed: list[RobotError] = []
    for answer in _answers(robot, memory, asked):
        try:
            found = await answer
        except (BadName, BadValue):
            raise
        except RobotError as error:
            failed.append(error)
            continue
        if found and found.samples:
            return found, failed
        empty = empty or found
    return empty, failed


def _answers(robot: Robot, memory: Memory, asked: Asked) -> Iterator[Awaitable[Found | None]]:
    """Who is asked, in this order: the Data Black Box, this server's recordings, the bag that stands for the robot, and
    those that were opened, the last one first.
    """
    own = _own_recordings(memory)
    subject = [memory.subject_name] if memory.subject else []
    bags = dict.fromkeys([*subject, *memory.opened_names()])
    yield _ask_data_black_box(robot, asked)
    for name in own:
        yield _ask_bag(robot, memory, asked, name, "this server's recording")
    for name in bags:
        if name not in own:
            yield _ask_bag(robot, memory, asked, name, "the bag")


def _own_recordings(memory: Memory) -> list[str]:
    """The black box first while it runs, then the newest recording first; what former servers left is none of them."""
    own = recordings(memory)
    running = [name for name in own if name == BLACK_BOX and own[name].is_running]
    return list(dict.fromkeys([*running, *reversed(own)]))


async def _ask_data_black_box(robot: Robot, asked: Asked) -> Found | None:
    box = None if robot.policy.recorded else await find_box(robot)
    if box is None:
        return None
    kind = await _known_type(robot, asked)
    now_ns = time.time_ns()
    start_ns, end_ns = _moment("time_start", asked.start, now_ns), _moment("time_end", asked.end, now_ns)
    if start_ns is not None and end_ns is not None and end_ns < start_ns:
        raise BadValue("time_end", f"{asked.end!r} is before {asked.start!r}.")
    end_ns = None if end_ns is None else last_ns_of(asked.end, end_ns)
    answered = await box.last(Question(asked.topic, kind, start_ns, end_ns, asked.bucket), asked.number)
    unconfirmed = "" if answered.type else f"This box does not keep types: right only if they are {kind}."
    kind = answered.type or kind
    if answered.samples and not kind:
        raise UnknownInterface(
            f"The Data Black Box has {len(answered.samples)} messages of {asked.topic}, but does not say their type.",
            "Give message_type, such as sensor_msgs/msg/LaserScan.",
        )
    if kind:
        await robot.values.learn(kind)
    note = " ".join(filter(None, (answered.problem, unconfirmed if answered.samples else "")))
    return Found(_words(box), kind, answered.samples, robot.values.codec, note)


def _words(box: DataBlackBox) -> str:
    return f"the WiseVision Data Black Box (generation {box.generation}, {box.service})"


async def _known_type(robot: Robot, asked: Asked) -> str:
    """The type that was asked for, else the one that the topic has now, else nothing."""
    if asked.type:
        return asked.type
    present = await robot.graph.endpoints(asked.topic)
    return present.types[0] if len(present.types) == 1 else ""


def _moment(name: str, text: str, now_ns: int) -> int | None:
    if not text.strip():
        return None
    return moment_ns(name, text, None, now_ns)


async def _ask_bag(robot: Robot, memory: Memory, asked: Asked, name: str, words: str) -> Found | None:
    def read() -> tuple[Any, int, list[Sample], Sample | None]:
        with memory.reading(name) as bag:
            topic = find_topic(bag, asked.topic)
            span = replace(span_in(memory, bag, asked.start, asked.end), topics=(topic.name,))
            newest = (sample for _, sample in bag.messages(span, newest_first=True))
            return topic, times_of(memory, bag)[1], *taken(islice(newest, asked.number or None), MAX_MESSAGES)

    try:
        topic, last_ns, newest, beyond = await asyncio.to_thread(read)
    except NotFound:
        return None
    codec = codec_of(await definitions_of(topic, robot))
    notes: list[str] = []
    if is_relative(asked.start) or is_relative(asked.end):
        notes.append(f"Counted from its end, {iso_time(last_ns)}.")
    if beyond:
        earlier = exact_time(newest[-1].received_ns - 1)
        notes.append(f"There are earlier ones too: for those, give time_end {earlier}.")
    return Found(f"{words} {name}", topic.type, newest[::-1], codec, " ".join(notes))


def _show(asked: Asked, view: View, found: Found, failed: Sequence[RobotError]) -> StoredMessages:
    samples = found.samples[:: -view.every_n][::-1]
    shown, rendered, bad = rendered_within(found.type, found.codec, samples, view) if samples else ([], [], 0)
    if samples and not shown:
        raise BadData(
            f"{found.source} has {bad} messages of {asked.topic}, but none is a {found.type}.",
            "Give the right message_type: the messages were stored with another type, or another version of it.",
        )
    notes = [f"Another source failed: {error.message}" for error in failed] + [found.note]
    if asked.type not in ("", found.type):
        notes.append(f"They are {found.type}, not {asked.type}.")
    if len(shown) + bad < len(samples):
        notes.append(f"{len(samples) - len(shown) - bad} more do not fit, evenly left out: choose fields, or every_n.")
    if bad:
        notes.append(f"{bad} message(s) are not what their type says and are left out.")
    if not samples:
        notes.append("None in that time." if asked.start or asked.end else "It has none of this topic.")
    return StoredMessages(
        found.source,
        asked.topic,
        found.type,
        [iso_time(each.received_ns) if each.received_ns else "" for each in shown],
        [each.value for each in rendered],
        len(shown),
        len(found.samples),
        sorted({path for each in rendered for path in each.truncated}),
        " ".join(filter(None, notes)),
    )


def _nobody(asked: Asked) -> NotFound:
    return NotFound(
        f"Nobody has kept messages of {asked.topic}: no Data Black Box, no recording and no opened bag has it.",
        "Start the server with --black-box, record with ros2_record_start, or open a bag with ros2_bag_info.",
    )
