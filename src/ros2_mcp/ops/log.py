"""What the robot's nodes said: lines of /rosout since a time, by node, level and text."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import timezone
from fnmatch import fnmatchcase
from typing import Any, cast

from ros2_mcp.model.errors import BadInput, BadValue
from ros2_mcp.model.names import did_you_mean
from ros2_mcp.model.samples import Sample
from ros2_mcp.ops.results import iso_time
from ros2_mcp.ops.sources.source import Missing, Source
from ros2_mcp.ops.sources.times import absolute_ns
from ros2_mcp.robot import Robot
from ros2_mcp.robot.log import LOG_TYPE, TOPIC, level_of

LEVELS: Mapping[str, int] = {"debug": 10, "info": 20, "warn": 30, "error": 40, "fatal": 50}
MAX_TEXT = 2000
_HISTORY_S = 1.0
"""Nodes send what they said lately as soon as they have matched, which takes them up to a second."""
_READY_S = 20.0
"""As long as a bridge may take to start."""
_LINE_BYTES = 100
"""Of a line beside its texts: time, level, and the names of the fields."""
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
    """Lines that are kept; the first call of a server that has not listened yet waits for what nodes said lately.

    Raises:
        BadInput: for a level, time or limit that cannot be.
        LinkError: if there is no bridge to listen with.
    """
    since_ns, least = since(request.since, time.time_ns()), level_number(request.level)
    if not 1 <= request.limit <= 5000:
        raise BadInput(f"limit: {request.limit} is out of range.", "Give 1 to 5000.")
    await _listening(robot)
    await robot.values.learn(LOG_TYPE)
    kept = robot.log.lines
    lines = [
        line
        for sample in kept
        if level_of(sample.data) >= least and (line := _matching(robot, sample, request, since_ns))
    ]
    shown = _within(lines[-request.limit :], max_bytes)
    return Log(
        shown,
        len(lines),
        len(kept),
        robot.log.dropped,
        iso_time(robot.log.since_ns),
        _note(robot, lines, shown, since_ns),
    )


async def read_recorded(source: Source, request: LogRequest, max_bytes: int) -> Log:
    """Lines of /rosout that a recording has in the source's time; `since` has no meaning there.

    Raises:
        BadInput: for a level that cannot be.
        NotFound: if /rosout was not recorded.
    """
    least = level_number(request.level)
    (capture,) = await source.captures([TOPIC])
    if isinstance(capture, Missing):
        raise capture.error
    _, messages, trouble = capture.readable()
    lines = [
        _line(message) for message in cast("Any", messages) if message.level >= least and _fits(message, request, 0)
    ]
    shown = _within(lines[-request.limit :], max_bytes)
    note = f"The newest {len(shown)} are shown. {trouble}".rstrip() if len(shown) < len(lines) else trouble
    begin = iso_time(capture.start_ns)
    return Log(shown, len(lines), len(capture.samples), capture.dropped, begin, note, source.words)


def line_of(robot: Robot, sample: Sample) -> LogLine:
    """A line of /rosout whose type has been learnt."""
    return _line(robot.values.decode(LOG_TYPE, sample))


def _line(message: Any) -> LogLine:
    stamp_ns = message.stamp.sec * 1_000_000_000 + message.stamp.nanosec
    text = message.msg if len(message.msg) <= MAX_TEXT else f"{message.msg[:MAX_TEXT]}… ({len(message.msg)} characters)"
    return LogLine(
        iso_time(stamp_ns),
        _NAMES.get(message.level, str(message.level)),
        message.name,
        text,
        message.file.rpartition("/")[2],
        message.function,
        message.line,
    )


def level_number(name: str) -> int:
    """The number of a level's name; empty is every level. Raises `BadInput` for another word."""
    word = {"warning": "warn", "critical": "fatal"}.get(name.strip().lower(), name.strip().lower())
    if word and word not in LEVELS:
        raise BadInput(f"There is no level {name!r}.", did_you_mean(word, list(LEVELS), f"Give {', '.join(LEVELS)}."))
    return LEVELS.get(word, 0)


def since(given: str, now_ns: int) -> int:
    """A Unix time in nanoseconds out of seconds ago or an ISO 8601 time (UTC if it names no zone); empty is 0.

    Raises:
        BadValue: for anything else.
    """
    if not given.strip():
        return 0
    try:
        seconds = float(given)
    except ValueError:
        return absolute_ns("since", given.strip(), timezone.utc, _SINCE_HINT)
    if not 0 <= seconds < 1e9:
        raise BadValue("since", f"{given} is no number of seconds ago.", "Give one that is not negative, such as 30.")
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


async def _listening(robot: Robot) -> None:
    """Begins to listen, if nobody has yet, and gives nodes the time to tell what they said lately."""
    robot.log.start()
    await robot.graph.ready()
    await robot.log.wait_listening(_READY_S)
    await robot.graph.endpoints(TOPIC)  # after discovery has settled
    young_s = (time.time_ns() - robot.log.since_ns) / 1e9
    await asyncio.sleep(max(0.0, _HISTORY_S - young_s))


def _matching(robot: Robot, sample: Sample, request: LogRequest, since_ns: int) -> LogLine | None:
    message: Any = robot.values.decode(LOG_TYPE, sample)
    return _line(message) if _fits(message, request, since_ns) else None


def _fits(message: Any, request: LogRequest, since_ns: int) -> bool:
    stamp_ns = message.stamp.sec * 1_000_000_000 + message.stamp.nanosec
    return stamp_ns >= since_ns and is_node(message.name, request.node) and has_text(message.msg, request.pattern)


def _within(lines: Sequence[LogLine], max_bytes: int) -> list[LogLine]:
    """The newest lines that fit into a result."""
    fitting: list[LogLine] = []
    for line in reversed(lines):
        max_bytes -= len(line.text.encode()) + len(line.node) + len(line.function) + len(line.file) + _LINE_BYTES
        if max_bytes < 0 and fitting:
            break
        fitting.append(line)
    return fitting[::-1]


def _note(robot: Robot, lines: Sequence[LogLine], shown: Sequence[LogLine], since_ns: int) -> str:
    notes: list[str] = []
    if len(shown) < len(lines):
        notes.append(f"The newest {len(shown)} are shown: narrow it down, or raise limit.")
    if robot.log.dropped and (not lines or not since_ns or since_ns < robot.log.lines[0].received_ns):
        notes.append(f"{robot.log.dropped} older line(s) are no longer kept.")
    if since_ns and since_ns < robot.log.since_ns:
        notes.append("This server listens for a shorter time than that.")
    if robot.log.interruptions:
        notes.append(f"The bridge was lost {robot.log.interruptions} time(s): lines of that time may be missing.")
    if not robot.log.lines:
        notes.append("No node has said anything on /rosout.")
    return " ".join(notes)
