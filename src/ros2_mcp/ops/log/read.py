"""The log of the robot's nodes: lines of /rosout since a time, by node, level and text, live or recorded."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from time import monotonic
from typing import TYPE_CHECKING, Any

import anyio

from ros2_mcp.bags.stored import FOREVER
from ros2_mcp.guard.policy import bounded
from ros2_mcp.model.errors import BadData, BadInput
from ros2_mcp.model.names import did_you_mean
from ros2_mcp.model.samples import Sample
from ros2_mcp.model.text import counted, visible
from ros2_mcp.model.times import seconds_from_start
from ros2_mcp.ops.results.results import IF_ANY, SAID, beside, iso_time
from ros2_mcp.ops.sources.selection import undecodable
from ros2_mcp.ops.sources.source import Missing, Source
from ros2_mcp.ops.sources.times import absolute_ns, is_relative, is_seconds_ago, last_ns_of, parsed_ns
from ros2_mcp.robot import Robot
from ros2_mcp.robot.log import LOG_TYPE, MAX_LINES, TOPIC, level_of

if TYPE_CHECKING:
    from ros2_mcp.values.cdr import Codec

LEVELS: Mapping[str, int] = {"debug": 10, "info": 20, "warn": 30, "error": 40, "fatal": 50}
# The most characters of one line: a node that logs whole messages must not take the room of all others.
MAX_TEXT = 2000
# Nodes send their last lines (`TRANSIENT_LOCAL`) once they have matched, which takes up to a second.
_HISTORY_S = 1.0
# Nodes keep lines for ten seconds. If they had none, this is the wait for the next line.
_FIRST_S = 2.0
# The longest time in which a bridge may start.
_READY_S = 20.0
# Bytes of a line besides its texts: time, level, and the names of the fields.
_LINE_BYTES = 100
_SINCE_HINT = "Give seconds ago, such as 30, or a time, such as 2030-01-31T12:00:00Z."
_NAMES = {number: name.upper() for name, number in LEVELS.items()}


@dataclass(frozen=True, slots=True)
class LogLine:
    """One line: the time that its node gave it (UTC), level, node, text and origin.

    `node` is the name of its logger, written as a node's: `arm.driver` is /arm/driver. The name of a logger within a
    node follows the node's: /arm/driver/left.
    """

    time: str
    level: str
    node: str
    text: str
    file: str = ""
    function: str = ""
    line: int = 0


@dataclass(frozen=True, slots=True)
class Log:
    """The newest of the requested lines, the oldest first.

    `matched` lines match the filters, `kept` lines are in this server's memory, `dropped` older ones no longer are.
    `subscribed_since` is when this server subscribed to /rosout; lines from a few seconds before may be included. For a
    recording, `seconds_from_start` gives the receive time of each line as an offset from its start.
    """

    lines: Sequence[LogLine]
    matched: int = field(metadata=SAID)
    kept: int = field(metadata=SAID)
    dropped: int
    subscribed_since: str
    note: str = field(metadata=IF_ANY)
    source: str = "live"
    seconds_from_start: Sequence[float] = field(default=(), metadata=beside("lines"))

    def summary(self) -> str:
        """Return the result in one line."""
        where = "in memory" if self.source == "live" else f"in {self.source}"
        if not self.kept:
            return f"No lines {where}. {self.note}".rstrip()
        shown = f", the newest {len(self.lines)} shown" if len(self.lines) < self.matched else ""
        return f"{counted(self.kept, 'line')} {where}, {self.matched} matching{shown}. {self.note}".rstrip()


@dataclass(frozen=True, slots=True)
class LogRequest:
    """The filters of the lines: a time span (seconds ago or ISO 8601), a node, a minimum level and a text."""

    since: str = ""
    until: str = ""
    node: str = ""
    level: str = ""
    pattern: str = ""
    limit: int = 100


async def read(robot: Robot, request: LogRequest, max_bytes: int = 32_000) -> Log:
    """Return the lines in memory. The first call of a server waits for the nodes' last lines.

    Raises:
        BadInput: for an invalid level, time or limit.
        LinkError: if there is no bridge to listen with.
    """
    least, asked_at = level_number(request.level), monotonic()
    _span_ns(request, robot.now_ns())  # raises before any wait
    bounded("limit", request.limit, 1, MAX_LINES, "lines")
    robot.log.start()
    await robot.graph.ready()
    await robot.log.wait_listening(_READY_S)
    await robot.graph.endpoints(TOPIC)  # after discovery has settled
    # The robot's clock is known after its first answer. Seconds ago count from when they were asked for.
    since_ns, until_ns = _span_ns(request, robot.now_ns() - round((monotonic() - asked_at) * 1e9))
    await asyncio.sleep(max(0.0, _HISTORY_S - _listened_s(robot)))
    await _first_line(robot, _FIRST_S - _listened_s(robot))
    await robot.values.learn(LOG_TYPE)
    kept = robot.log.lines
    # the level is read from the bytes, so that most lines need not be decoded
    found = _Matching(robot.values.codec, LOG_TYPE, request, since_ns, until_ns)
    found.add([sample for sample in kept if level_of(sample.data) >= least])
    lines, matched = _fitting(found.messages, max_bytes), found.matched
    notes = [found.skipped] if found.skipped else []
    if len(lines) < matched:
        notes.append("Narrow the pattern, or raise limit, to see the others.")
    if robot.log.dropped and (not matched or not since_ns or since_ns < kept[0].received_ns):
        notes.append(f"{counted(robot.log.dropped, 'older line')} no longer in memory.")
    if since_ns and since_ns < robot.log.since_ns and kept:
        notes.append(f"This server subscribed to /rosout only at {iso_time(robot.log.since_ns)}.")
    if robot.log.interruptions:
        notes.append(
            f"The connection to the bridge was lost {counted(robot.log.interruptions, 'time')}: lines from then may be "
            "missing."
        )
    if not kept and (absence := await robot.graph.absence()):
        notes.append(absence)
    if not kept:
        began = f"Nothing was published on /rosout in the {_listened_s(robot):.0f} s since this server subscribed"
        notes.append(
            f"{began}, and /rosout replays only about 10 s of older lines. "
            "ros2_topic_subscribe of /rosout waits for the next line."
        )
    return Log(
        lines=lines,
        matched=matched,
        kept=len(kept),
        dropped=robot.log.dropped,
        subscribed_since=iso_time(robot.log.since_ns),
        note=" ".join(notes),
    )


def _span_ns(request: LogRequest, now_ns: int) -> tuple[int, int]:
    """Return the beginning and the end of the requested lines, as Unix times in ns, if `now_ns` is the robot's time."""
    if not request.until:
        return since(request.since, now_ns), FOREVER
    # until the end of the microsecond that is shown
    return since(request.since, now_ns), last_ns_of(request.until, since(request.until, now_ns, "end"))


def _listened_s(robot: Robot) -> float:
    return (robot.now_ns() - robot.log.since_ns) / 1e9


async def _first_line(robot: Robot, within_s: float) -> None:
    """Wait for a line if there is none yet."""
    has_come = asyncio.Event()
    end = robot.log.on_line(lambda _level, _line: has_come.set())
    with anyio.move_on_after(0 if robot.log.lines else within_s):
        await has_come.wait()
    end()


async def read_recorded(source: Source, request: LogRequest, max_bytes: int) -> Log:
    """Return the lines of /rosout that a recording has in the source's time; `since` is ignored.

    Raises:
        BadInput: for an invalid level or limit.
        NotFound: if /rosout was not recorded.
    """
    level_number(request.level)  # raises before anything is read
    bounded("limit", request.limit, 1, MAX_LINES, "lines")
    (capture,) = await source.captures([TOPIC], lambda stream: _Matching(stream.codec, stream.type, request))
    if isinstance(capture, Missing):
        raise capture.error
    found = capture.kept
    lines = _fitting(found.messages, max_bytes)
    shown_ns = list(found.received_ns)[len(found.received_ns) - len(lines) :]
    notes: list[str] = []
    return Log(
        lines=lines,
        matched=found.matched,
        kept=capture.received,
        dropped=capture.dropped,
        subscribed_since=iso_time(capture.start_ns),
        note=" ".join(filter(None, (*notes, found.skipped))),
        source=source.words,
        seconds_from_start=[
            seconds for at_ns in shown_ns if (seconds := seconds_from_start(at_ns, source.began_ns)) is not None
        ],
    )


class _Matching:
    """The newest messages that match the request, at most its limit; `matched` counts all that match."""

    def __init__(
        self, codec: Codec, type_name: str, request: LogRequest, since_ns: int = 0, until_ns: int = FOREVER
    ) -> None:
        self.messages: deque[Any] = deque(maxlen=request.limit)
        self.received_ns: deque[int] = deque(maxlen=request.limit)
        self.matched = 0
        self._undecodable = 0
        self._trouble = ""
        self._codec = codec
        self._type = type_name
        self._request = request
        self._span_ns = since_ns, until_ns

    def add(self, samples: Sequence[Sample]) -> None:
        """Add messages, in the order of time."""
        for sample in samples:
            try:
                message: Any = self._codec.decode(self._type, sample.data)
            except BadData as error:
                self._undecodable += 1
                self._trouble = self._trouble or str(error)
                continue
            if self._is_meant(message):
                self.matched += 1
                self.messages.append(message)
                self.received_ns.append(sample.received_ns)

    @property
    def skipped(self) -> str:
        """A sentence with the number of lines that could not be decoded; empty if all could."""
        return undecodable(self._undecodable, self._trouble) if self._undecodable else ""

    def _is_meant(self, message: Any) -> bool:
        return (
            message.level >= level_number(self._request.level)
            and self._span_ns[0] <= _stamp_ns(message) <= self._span_ns[1]
            and is_node(message.name, self._request.node)
            and has_text(message.msg, self._request.pattern)
        )


def _fitting(messages: Sequence[Any], max_bytes: int) -> list[LogLine]:
    """Return the newest lines that fit, the oldest first.

    They are not evenly spread, as by `ops/sources/selection.fit`, because the last lines of a log matter most.
    """
    lines: list[LogLine] = []
    for message in reversed(messages):
        line = _line(message)
        max_bytes -= (
            len(visible(line.text).encode()) + len(line.node) + len(line.function) + len(line.file) + _LINE_BYTES
        )
        if max_bytes < 0 and lines:
            break
        lines.append(line)
    return lines[::-1]


def line_of(robot: Robot, sample: Sample) -> LogLine:
    """Return a line of /rosout. Its type must have been learnt."""
    return _line(robot.values.decode(LOG_TYPE, sample))


def _line(message: Any) -> LogLine:
    text = message.msg if len(message.msg) <= MAX_TEXT else f"{message.msg[:MAX_TEXT]}… ({len(message.msg)} characters)"
    return LogLine(
        time=iso_time(_stamp_ns(message)),
        level=_NAMES.get(message.level, str(message.level)),
        node=_node_of(message.name),
        text=text,
        file=message.file.rpartition("/")[2],
        function=message.function,
        line=message.line,
    )


def _node_of(logger: str) -> str:
    return f"/{logger.replace('.', '/')}" if logger else ""


def _stamp_ns(message: Any) -> int:
    return message.stamp.sec * 1_000_000_000 + message.stamp.nanosec


def level_number(name: str) -> int:
    """Return the number of a level's name; an empty name is every level. Raises `BadInput` for another word."""
    word = {"warning": "warn", "critical": "fatal"}.get(name.strip().lower(), name.strip().lower())
    if word and word not in LEVELS:
        raise BadInput(f"There is no level {name!r}.", did_you_mean(word, list(LEVELS), f"Give {', '.join(LEVELS)}."))
    return LEVELS.get(word, 0)


def since(text: str, now_ns: int, name: str = "since") -> int:
    """Return the Unix time in nanoseconds for seconds ago, `2 min ago`, a UNIX time or an ISO 8601 time; 0 if empty.

    Raises:
        BadValue: for anything else.
    """
    if not text.strip():
        return 0
    if is_seconds_ago(text):
        return now_ns - int(float(text) * 1e9)
    if is_relative(text):
        return parsed_ns(name, text, None, now_ns)
    return absolute_ns(name, text.strip(), _SINCE_HINT)


def is_node(name: str, node: str) -> bool:
    """Return whether a logger (`ns.node` or `/ns/node`, or its child `ns.node.part`) belongs to the node. `node` is its
    name in either form, a part of it or a glob.
    """
    name = name.strip("/").replace("/", ".")
    dotted = node.strip().strip("/").replace("/", ".")
    if any(sign in dotted for sign in "*?["):
        return fnmatchcase(name, dotted)
    if node.strip().startswith("/"):
        return name == dotted or name.startswith(f"{dotted}.")
    return dotted.lower() in name.lower()


def has_text(text: str, pattern: str) -> bool:
    """Return whether a text contains the pattern, regardless of case; with `*` or `?`
    it is a glob for the whole text.
    """
    if any(sign in pattern for sign in "*?"):
        return fnmatchcase(text.lower(), pattern.lower())
    return pattern.lower() in text.lower()
