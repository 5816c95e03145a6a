"""Values of one topic, the log, and what there is to be looked at."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ros2_mcp.model.errors import NotFound, RobotError
from ros2_mcp.model.text import named
from ros2_mcp.ops.log import read as log
from ros2_mcp.ops.pictures.next_message import next_message
from ros2_mcp.ops.results.results import as_json, silent
from ros2_mcp.ops.sources.source import Source
from ros2_mcp.robot.log import LOG_TYPE
from ros2_mcp.view.look import Content, Look, Panel, Shown

_FIRST = ("nav_msgs/msg/Odometry", "sensor_msgs/msg/JointState", "sensor_msgs/msg/BatteryState")
"""What is shown where nothing is chosen: what moves, or else what there is."""
_MOST_ARRAY, _MOST_STRING, _MOST_BYTES = 12, 400, 12_000
"""Of one message: as much as a person looks at while it changes."""
_MOST_JOINTS = 64
"""Of what has a row for each joint: a humanoid with both hands."""
_MOST_LINES, _MOST_LINE_BYTES = 120, 40_000
_MOST_TOPICS = 1000
_BEFORE_NS = 60_000_000_000
"""Of a recording's log: what was said in the minute before the time that is shown."""


class ValuesPanel(Panel):
    """The newest message of a topic, with its rate."""

    name = "values"
    period_s = 0.2

    def __init__(self) -> None:
        self._shown = Shown()

    async def show(self, look: Look) -> Content | None:
        """The newest message of the chosen topic, else of one that tells how the robot moves."""
        from ros2_mcp.values.render import RenderOptions  # numpy: not at the start

        topic = look.chosen or await first_topic(look.source)
        if not topic:
            raise NotFound("There is no topic to show.")
        rate_hz: float | None = None
        publishers: Sequence[str] = ()
        if look.source.is_live:
            found = await self._shown.newer(look.robot, topic)
            if found is None:
                why = f"No message has come on {named(topic)} yet."
                return None if self._shown.sample else {"topic": topic, "why": why}
            sample, newest, listening = found
            kind, rate_hz = listening.type, newest.rate_hz()
            publishers = sorted({one.who for one in listening.publishers})
        else:
            kind = await look.source.type_of(topic)
            sample = (await next_message(look.source, topic, kind, silent)).sample
            await look.robot.values.learn(kind)
        most = _MOST_JOINTS if kind == "sensor_msgs/msg/JointState" else _MOST_ARRAY
        options = RenderOptions(max_array=most, max_string=_MOST_STRING, max_bytes=_MOST_BYTES)
        rendered = await look.robot.values.render(kind, sample.data, options)
        return {
            "topic": topic,
            "type": kind,
            "at_s": sample.received_ns / 1e9,
            "rate_hz": rate_hz,
            "publishers": list(publishers),
            "bytes": sample.size,
            "value": rendered.value,
        }


class LogPanel(Panel):
    """What the robot's nodes say."""

    name = "log"
    period_s = 0.5

    async def show(self, look: Look) -> Content | None:
        """The newest lines, the oldest first."""
        request = log.LogRequest(level="info", limit=_MOST_LINES)
        if look.source.is_live:
            return {"lines": as_json(await self._live(look))}
        span_ns = look.source.covers_ns or (0, 0)
        part = look.source.part(span_ns[1] - _BEFORE_NS, span_ns[1])
        try:
            lines = (await log.read_recorded(part, request, _MOST_LINE_BYTES)).lines
        except NotFound:
            return {"lines": [], "why": "The recording has no /rosout: the log of the nodes was not recorded."}
        why = {} if lines else {"why": "No node logged a line at INFO or above in the minute before this time."}
        return {"lines": as_json(lines), **why}

    async def _live(self, look: Look) -> list[log.LogLine]:
        robot = look.robot
        robot.log.start()
        kept = robot.log.lines[-_MOST_LINES:]
        if not kept:
            return []
        await robot.values.learn(LOG_TYPE)
        lines: list[log.LogLine] = []
        for sample in kept:
            try:
                lines.append(log.line_of(robot, sample))
            except RobotError:  # a line that cannot be decoded hides no other one
                continue
        return lines


class RobotPanel(Panel):
    """Which robot it is, whether it is reached, and which topics there are."""

    name = "robot"
    period_s = 1.0

    def __init__(self, title: str, source: Source) -> None:
        self._title = title
        self._source = source

    async def show(self, look: Look) -> Content | None:
        """Its state; never raises, as it is what says why the others show nothing."""
        content: dict[str, Any] = {"title": self._title, "live": look.source.is_live, "topics": []}
        if self._source.covers_ns:
            begin_ns, end_ns = self._source.covers_ns
            content |= {"source": self._source.title, "begin_s": begin_ns / 1e9, "end_s": end_ns / 1e9}
        graph = look.robot.graph
        try:
            rows = sorted(await graph.topics())[:_MOST_TOPICS]
        except RobotError as error:
            return {**content, "why": str(error)}
        own = ("/parameter_events",)
        content["topics"] = [[row.name, *row.types[:1]] for row in rows if row.publishers and row.name not in own]
        if look.source.is_live:
            content["why"] = await graph.absence() or graph.failure
        return content


async def first_topic(source: Source) -> str:
    """What is shown where nothing is chosen; empty where there is none of that."""
    for kind in _FIRST:
        if found := await source.publishing(kind):
            return found[0]
    return ""
