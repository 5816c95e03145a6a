"""Why a robot may stand though it is commanded, by its graph: what is before it, who else drives it, limits of 0."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.text import named
from ros2_mcp.ops.motion.find import SCAN, scan_of
from ros2_mcp.ops.navigation.base import zero_limits
from ros2_mcp.ops.pictures.next_message import next_message
from ros2_mcp.ops.results.results import silent
from ros2_mcp.ops.sources.live import Live
from ros2_mcp.ops.space.meaning import meaning_of
from ros2_mcp.robot import Robot

_SCAN_S = 1.0
"""Scans come at 5 Hz or more."""
_MOST_NODES, _MOST_NAMED = 4, 3
"""Who listens to a command input is one base, perhaps a recorder and a filter."""


async def others_on(robot: Robot, topic: str) -> str:
    """A sentence on who else may command this input; empty where nobody does."""
    try:
        present = await robot.graph.endpoints(topic)
    except RobotError:  # what was driven is driven, and that is to be told
        return ""
    others = sorted({one.node for one in present.publishers if not one.ours})
    if not others:
        return ""
    who = ", ".join(map(named, others))
    return f"{who} may publish on {named(topic)}, too: the robot follows the latest command, whoever sent it."


async def why_it_stands(robot: Robot, topic: str, scan: str = "") -> Sequence[str]:
    """Sentences on what may hold a robot that was commanded on a topic: what its scan shows, and limits of 0.

    `scan` is the topic of a scan; empty: what is found. What cannot be found out is left out.
    """
    return [each for each in await asyncio.gather(_ahead(robot, topic, scan), _limits(robot, topic)) if each]


async def _ahead(robot: Robot, topic: str, scan: str) -> str:
    try:
        found = await scan_of(robot, scan, topic)
        source = Live(robot).lasting(_SCAN_S)
        newest = await next_message(source, found.topic, SCAN, silent)
        meaning = await meaning_of(source, found.topic, SCAN, newest.message, newest.sample.received_ns)
    except RobotError:
        return ""
    return f"{named(found.topic)}: {meaning.scan}" if meaning and meaning.scan else ""


async def _limits(robot: Robot, topic: str) -> str:
    try:
        present = await robot.graph.endpoints(topic)
    except RobotError:
        return ""
    nodes = sorted({one.node for one in present.subscribers if not one.ours})[:_MOST_NODES]
    found = [each for told in await asyncio.gather(*(zero_limits(robot, node) for node in nodes)) for each in told]
    return " ".join(found[:_MOST_NAMED])
