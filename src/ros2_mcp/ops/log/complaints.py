"""What the robot's nodes warned of while something was tried: the reason of a failure is mostly in their own words."""

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
"""A node may log the reason before the call's time by our clock: the clocks of two machines differ by that at most."""
_OTHER_CLOCK_NS = 60_000_000_000
"""Lines whose stamp is so far from their receipt are stamped by another clock, such as simulated time."""
_LISTENING_S = 1.0
"""Until /rosout is subscribed; nodes then send what they logged in the last ten seconds."""
_LATE_S = 0.4
"""For a line that is still on its way: the log is drained several times a second."""
_LOOK_S = 0.05
_MOST_LINES = 3
"""In a sentence; ros2_log_read has the rest."""


@dataclass(frozen=True, slots=True)
class Complaints:
    """The WARN and ERROR lines from something on that is tried: made before it, asked after it has failed."""

    robot: Robot
    since_ns: int

    async def said(self, *nodes: str) -> str:
        """A sentence with the WARN and ERROR lines since then, of these nodes alone if any are given; empty where there
        are none. Takes up to 1.5 s; raises no `RobotError`.
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
        """Each text of a node once, where it was said last."""
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
    """From now on; the log is listened to, if it was not yet."""
    robot.log.start()
    return Complaints(robot, robot.now_ns())
