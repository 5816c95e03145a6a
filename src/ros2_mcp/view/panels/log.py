"""The log of the robot's nodes."""

from __future__ import annotations

from ros2_mcp.model.errors import NotFound, RobotError
from ros2_mcp.model.text import counted
from ros2_mcp.ops.log import read as log
from ros2_mcp.ops.results.results import as_json
from ros2_mcp.robot.log import LOG_TYPE
from ros2_mcp.view.look import Content, Look, Panel

_MOST_LINES, _MOST_LINE_BYTES = 120, 40_000
_BEFORE_NS = 60_000_000_000
"""Part of a recording's log that is shown: the minute before the time shown."""


class LogPanel(Panel):
    """Shows the log of the robot's nodes."""

    name = "log"
    period_s = 0.5

    async def show(self, look: Look) -> Content | None:
        """Return the newest lines, the oldest first."""
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
            except RobotError:  # a line that cannot be decoded must not hide others
                continue
        return lines

    def words(self, content: Content) -> str:
        """Return the content in one line for the model."""
        lines = content.get("lines") or ()
        if not lines:
            return "no line"
        return f"{counted(len(lines), 'line')}, the last: {str(lines[-1].get('text', ''))[:120]}"
