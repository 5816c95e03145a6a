"""Explain by the graph why a commanded robot may not move: obstacles near it, other
publishers, velocity limits of 0.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

from ros2_mcp.model.aside import load
from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.meanings import bearing_in_words
from ros2_mcp.model.poses import Pose
from ros2_mcp.model.text import listed, named
from ros2_mcp.ops.motion.body import body_of
from ros2_mcp.ops.motion.find import Found, base_frame_of, located_on
from ros2_mcp.ops.motion.guarding import SCAN, candidates
from ros2_mcp.ops.navigation.base import zero_limits
from ros2_mcp.ops.pictures.next_message import next_message
from ros2_mcp.ops.results.results import silent
from ros2_mcp.ops.sources.live import Live
from ros2_mcp.robot import VELOCITY_TYPES, Robot

_SCAN_S = 1.0
"""Time for a scan: scans come at 5 Hz or more."""
_MONITOR = "/collision_monitor"
_MOST_NODES, _MOST_NAMED = 4, 3
"""The subscribers of a command input are one base, perhaps a recorder and a filter."""


async def others_on(robot: Robot, topic: str) -> str:
    """Return a sentence on the other nodes that may publish on this command input; empty if there are none."""
    try:
        present = await robot.graph.endpoints(topic)
    except RobotError:  # the drive is over, and its result is still to be reported
        return ""
    others = sorted({one.node for one in present.publishers if not one.ours})
    if not others:
        return ""
    who = ", ".join(map(named, others))
    told = f"{who} may publish on {named(topic)}, too: the robot follows the latest command, whoever sent it."
    return f"{told} {await _past_a_monitor(robot, topic, others)}".rstrip()


async def _past_a_monitor(robot: Robot, topic: str, publishers: Sequence[str]) -> str:
    """Return a sentence if the topic is the output of Nav2's collision monitor, because the monitor does not check what
    other nodes publish there; else "".
    """
    for node in publishers:
        if not node.endswith(_MONITOR):
            continue
        try:
            inputs = [one.name for one in (await robot.graph.node(node)).subscribers if _is_velocity(one.types)]
        except RobotError:
            return ""
        where = f" It does check commands on {listed(inputs, 2)}." if inputs else ""
        return f"{named(topic)} is the output of {named(node)}: it does not check commands published there.{where}"
    return ""


def _is_velocity(types: Sequence[str]) -> bool:
    return not VELOCITY_TYPES.keys().isdisjoint(types)


async def why_it_stands(robot: Robot, topic: str, odometry: Found, scan: str = "") -> Sequence[str]:
    """Return sentences on what may keep a robot from moving that was commanded on a topic: the nearest obstacle in its
    scan, and velocity limits of 0.

    `scan` is the topic of a scan; if it is empty, one is found. What cannot be determined is omitted.
    """
    told = await asyncio.gather(_near(robot, topic, odometry, scan), _limits(robot, topic))
    return [each for each in told if each]


async def _near(robot: Robot, topic: str, odometry: Found, scan: str) -> str:
    """Return a sentence on the obstacle nearest to the robot's outline, by its scan; empty if it is unknown."""
    try:
        found = [one for one in await candidates(robot, topic) if one.type == SCAN and scan in ("", one.topic)]
        if not found:
            return ""
        base_frame = await base_frame_of(robot, odometry)
        newest = await next_message(Live(robot).lasting(_SCAN_S), found[0].topic, SCAN, silent)
        located = await located_on(robot, newest.message.header.frame_id, base_frame)
        body = await body_of(robot, base_frame, topic)
    except RobotError:
        return ""
    await load("ros2_mcp.world.scans")  # with numpy: not before it is needed
    from ros2_mcp.world.scans import nearest_to

    nearest = nearest_to(body.outline, newest.message, located.pose if located else Pose())
    if nearest is None:
        return ""
    return (
        f"{named(found[0].topic)}: nearest obstacle {nearest.gap_m:.2f} m from the robot's outline, "
        f"{bearing_in_words(nearest.bearing_deg)}."
    )


async def _limits(robot: Robot, topic: str) -> str:
    try:
        present = await robot.graph.endpoints(topic)
    except RobotError:
        return ""
    nodes = sorted({one.node for one in present.subscribers if not one.ours})[:_MOST_NODES]
    found = [each for told in await asyncio.gather(*(zero_limits(robot, node) for node in nodes)) for each in told]
    return " ".join(found[:_MOST_NAMED])
