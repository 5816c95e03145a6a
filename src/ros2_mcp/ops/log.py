"""The log of the robot's nodes: lines of /rosout since a time, by node, level and text, live or recorded."""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import timezone
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Any

from ros2_mcp.guard.policy import bounded
from ros2_mcp.model.errors import BadData, BadInput, BadValue
from ros2_mcp.model.names import did_you_mean
from ros2_mcp.model.samples import Sample
from ros2_mcp.model.text import visible
from ros2_mcp.ops.results import iso_time
from ros2_mcp.ops.sources.selection import undecodable
from ros2_mcp.ops.sources.source import Missing, Source
from ros2_mcp.ops.sources.times import absolute_ns
from ros2_mcp.robot import Robot
from ros2_mcp.robot.log import LOG_TYPE, MAX_LINES, TOPIC, level_of

if TYPE_CHECKING:
    from ros2_mcp.codec.cdr import Codec

LEVELS: Mapping[str, int] = {"debug": 10, "info": 20, "warn": 30, "error": 40, "fatal": 50}
# Characters of one line: a node that logs whole messages must not take the room of all others.
MAX_TEXT = 2000
# Nodes send their last lines (`TRANSIENT_LOCAL`) as soon as they have matched, which takes them up to a second.
_HISTORY_S = 1.0
# As long as a bridge may take to start.
_READY_S = 20.0
# Of a line beside its texts: time, level, and the names of the fields.
_LINE_BYTES = 100
_SINCE_HINT = "It is neither seconds nor a time: give seconds ago, such as 30, or a time like 2030-01-31T12:00:00Z."
_NAMES = {number: name.upper() for name, number in LEVELS.items()}


@dataclass(frozen=True, slots=True)
class LogLine:
    """One line: the time that its node gave it (UTC), level, the name of the node's logger, text and origin."""

    time: str
    level: str
    node: str
    text: str
    file: str = ""
    function: str = ""
    line: int = 0


@dataclass(frozen=True, slots=True)
class Log:
    """The newest lines that were asked for, the oldest first.

    `matched` lines met the conditions, `kept` are in memory, `dropped` had to go from there. `listening_since` is when
    this server began to listen; lines from a few seconds before may be there too.
    """

    lines: Sequence[LogLine]
    matched: int
    kept: int
    dropped: int
    listening_since: str
    note: str
    source: str = "live"

    def summary(self) -> str:
        """One line."""
        return f"{len(self.lines)} of {self.matched} line(s), {self.kept} kept. {self.note}".rstrip()


@dataclass(frozen=True, slots=True)
class LogRequest:
    """Which lines: since when (seconds ago or ISO 8601), of which node, from which level on, with which text."""

    since: str = ""
    node: str = ""
    level: str = ""
    pattern: str = ""
    limit: int = 100


async def read(robot: Robot, request: LogRequest, max_bytes: int = 32_000) -> Log:
    """Lines that are kept; the first call of a server that has not listened yet waits for the nodes' last lines.

    Raises:
        BadInput: for a level, time or limit that cannot be.
        LinkError: if there is no bridge to listen with.
    """
    since_ns, least = since(request.since, time.time_ns()), level_number(request.level)
    bounded("limit", request.limit, 1, MAX_LINES, "lines")
    robot.log.start()
    await robot.graph.ready()
    await robot.log.wait_listening(_READY_S)
    await robot.graph.endpoints(TOPIC)  # after discovery has settled
    listened_s = (time.time_ns() - robot.log.since_ns) / 1e9
    await asyncio.sleep(max(0.0, _HISTORY_S - listened_s))
    await robot.values.learn(LOG_TYPE)
    kept = robot.log.lines
    # the level is read from the bytes: most lines of a talkative robot need not be decoded
    found = _Matching(robot.values.codec, LOG_TYPE, request, since_ns)
    found.add([sample for sample in kept if level_of(sample.data) >= least])
    lines, matched = _fitting(found.messages, max_bytes), found.matched
    notes = [found.skipped] if found.skipped else []
    if len(lines) < matched:
        notes.append(f"The newest {len(lines)} are shown: narrow it down, or raise limit.")
    if robot.log.dropped and (not matched or not since_ns or since_ns < kept[0].received_ns):
        notes.append(f"{robot.log.dropped} older line(s) are no longer kept.")
    if since_ns and since_ns < robot.log.since_ns:
        notes.append("This server listens for a shorter time than that.")
    if robot.log.interruptions:
        notes.append(f"The bridge was lost {robot.log.interruptions} time(s): lines of that time may be missing.")
    if not kept:
        notes.append("No node has said anything on /rosout.")
    return Log(
        lines=lines,
        matched=matched,
        kept=len(kept),
        dropped=robot.log.dropped,
        listening_since=iso_time(robot.log.since_ns),
        note=" ".join(notes),
    )


async def read_recorded(source: Source, request: LogRequest, max_bytes: int) -> Log:
    """Lines of /rosout that a recording has in the source's time; `since` has no meaning there.

    Raises:
        BadInput: for a level that cannot be.
        NotFound: if /rosout was not recorded.
    """
    level_number(request.level)  # raises before anything is read
    (capture,) = await source.captures([TOPIC], lambda stream: _Matching(stream.codec, stream.type, request))
    if isinstance(capture, Missing):
        raise capture.error
    found = capture.kept
    lines = _fitting(found.messages, max_bytes)
    notes = [f"The newest {len(lines)} are shown."] if len(lines) < found.matched else []
    return Log(
        lines=lines,
        matched=found.matched,
        kept=capture.received,
        dropped=capture.dropped,
        listening_since=iso_time(capture.start_ns),
        note=" ".join(filter(None, (*notes, found.skipped))),
        source=source.words,
    )


class _Matching:
    """The newest messages that are meant, at most the limit of the request; `matched` counts all."""

    def __init__(self, codec: Codec, type_name: str, request: LogRequest, since_ns: int = 0) -> None:
        self.messages: deque[Any] = deque(maxlen=request.limit)
        self.matched = 0
        self._undecodable = 0
        self._trouble = ""
        self._codec = codec
        self._type = type_name
        self._request = request
        self._since_ns = since_ns

    def add(self, samples: Sequence[Sample]) -> None:
        """Takes in messages, in the order of time."""
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

    @property
    def skipped(self) -> str:
        """In words, how many could not be decoded; empty where all could."""
        return undecodable(self._undecodable, self._trouble) if self._undecodable else ""

    def _is_meant(self, message: Any) -> bool:
        return (
            message.level >= level_number(self._request.level)
            and _stamp_ns(message) >= self._since_ns
            and is_node(message.name, self._request.node)
            and has_text(message.msg, self._request.pattern)
        )


def _fitting(messages: Sequence[Any], max_bytes: int) -> list[LogLine]:
    """The newest of the lines, as many as fit, the oldest first.

    Not evenly spread, as `ops/sources/selection.fit` does: what a log says last is what matters.
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
    """A line of /rosout whose type has been learnt."""
    return _line(robot.values.decode(LOG_TYPE, sample))


def _line(message: Any) -> LogLine:
    text = message.msg if len(message.msg) <= MAX_TEXT else f"{message.msg[:MAX_TEXT]}… ({len(message.msg)} characters)"
    return LogLine(
        time=iso_time(_stamp_ns(message)),
        level=_NAMES.get(message.level, str(message.level)),
        node=message.name,
        text=text,
        file=message.file.rpartition("/")[2],
        function=message.function,
        line=message.line,
    )


def _stamp_ns(message: Any) -> int:
    return message.stamp.sec * 1_000_000_000 + message.stamp.nanosec


def level_number(name: str) -> int:
    """The number of a level's name; empty is every level. Raises `BadInput` for another word."""
    word = {"warning": "warn", "critical": "fatal"}.get(name.strip().lower(), name.strip().lower())
    if word and word not in LEVELS:
        raise BadInput(f"There is no level {name!r}.", did_you_mean(word, list(LEVELS), f"Give {', '.join(LEVELS)}."))
    return LEVELS.get(word, 0)


def since(text: str, now_ns: int) -> int:
    """A Unix time in nanoseconds out of seconds ago or an ISO 8601 time (UTC if it names no zone); empty is 0.

    Raises:
        BadValue: for anything else.
    """
    if not text.strip():
        return 0
    try:
        seconds = float(text)
    except ValueError:
        return absolute_ns("since", text.strip(), timezone.utc, _SINCE_HINT)
    if not 0 <= seconds < 1e9:
        raise BadValue("since", f"{text} is no number of seconds ago.", "Give one that is not negative, such as 30.")
    return now_ns - int(seconds * 1e9)


def is_node(name: str, node: str) -> bool:
    """Whether a logger (`ns.node`, or its child `ns.node.part`) is of the node: `/ns/node`, a part of it or a glob."""
    dotted = node.strip().strip("/").replace("/", ".")
    if any(sign in dotted for sign in "*?["):
        return fnmatchcase(name, dotted)
    if node.strip().startswith("/"):
        return name == dotted or name.startswith(f"{dotted}.")
    return dotted.lower() in name.lower()


def has_text(text: str, pattern: str) -> bool:
    """Whether a text contains the pattern, whatever its case; with `*` or `?` it is a glob for the whole text."""
    if any(sign in pattern for sign in "*?"):
        return fnmatchcase(text.lower(), pattern.lower())
    return pattern.lower() in text.lower()
