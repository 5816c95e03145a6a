"""Collect the warnings and errors that the robot's nodes log during an attempt: they
mostly give the reason of a failure.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import anyio

from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.text import LOG_LINE, named, quoted
from ros2_mcp.ops.log.read import LogLine, is_node, line_of
from ros2_mcp.robot import Robot
from ros2_mcp.robot.log import LOG_TYPE, level_of

_WARN = 30
_BEFORE_NS = 500_000_000
"""Lines are included from this long before the call, by our clock: the clocks of two
machines differ by that at most."""
_OTHER_CLOCK_NS = 60_000_000_000
"""Lines whose stamp is further than this from their receipt are stamped by another clock, such as simulated time."""
_LISTENING_S = 1.0
"""Time to subscribe to /rosout; nodes then send the lines that they logged in the last ten seconds."""
_LATE_S = 0.4
"""Time for a line that is still on its way: the log is drained several times a second."""
_LOOK_S = 0.05
_MOST_LINES = 3
"""The most lines in a sentence; ros2_log_read has the rest."""


@dataclass(frozen=True, slots=True)
class Complaints:
    """The WARN and ERROR lines that are logged during an attempt: create it before the attempt,
    and call `said` after a failure.
    """

    robot: Robot
    since_ns: int

    async def said(self, *nodes: str) -> str:
        """Return a sentence with the WARN and ERROR lines since then, only of these nodes if any are given; empty if
        there are none. Takes up to 1.5 s; raises no `RobotError`.
        """
        try:
            await self.robot.values.learn(LOG_TYPE)
        except RobotError:
            return ""
        await self.robot.log.wait_listening(_LISTENING_S)
        with anyio.move_on_after(_LATE_S):
            while not self._lines(nodes):
                await asyncio.sleep(_LOOK_S)
        lines = self._lines(nodes)[-_MOST_LINES:]
        told = "; ".join(f"{named(line.node)} {line.level}: {quoted(line.text, LOG_LINE)}" for line in lines)
        return f"The robot logged meanwhile: {told}." if told else ""

    def _lines(self, nodes: Sequence[str]) -> list[LogLine]:
        """Return the lines; a text that a node repeats is listed once, at its last place."""
        found: dict[tuple[str, str], LogLine] = {}
        for sample in self.robot.log.lines:
            if level_of(sample.data) < _WARN:
                continue
            message: Any = self.robot.values.decode(LOG_TYPE, sample)
            stamp_ns = message.stamp.sec * 1_000_000_000 + message.stamp.nanosec
            is_of_other_clock = abs(sample.received_ns - stamp_ns) > _OTHER_CLOCK_NS
            if (sample.received_ns if is_of_other_clock else stamp_ns) < self.since_ns - _BEFORE_NS:
                continue
            line = line_of(self.robot, sample)
            if not nodes or any(is_node(message.name, node) for node in nodes):
                found.pop((line.node, line.text), None)
                found[line.node, line.text] = line
        return list(found.values())


def complaints_from_now(robot: Robot) -> Complaints:
    """Return the warnings and errors logged from now on. Subscribes to /rosout if needed."""
    robot.log.start()
    return Complaints(robot, robot.now_ns())
