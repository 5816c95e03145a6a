"""The state of a running navigation, and problems that may stop it: sentences, within about five seconds."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Sequence

from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.graph import TopicRow
from ros2_mcp.model.text import listed, named
from ros2_mcp.ops.navigation.base import base_of
from ros2_mcp.ops.navigation.checks import NEEDS, nav_findings_in
from ros2_mcp.ops.navigation.readers import read_evidence
from ros2_mcp.ops.navigation.situation import Local, costmap_of, inactive_servers, local_of, sensors_of
from ros2_mcp.ops.navigation.targets import MAP_FRAME
from ros2_mcp.ops.navigation.whereabouts import whereabouts
from ros2_mcp.robot import Robot

_PART_S = 2.0
"""Limit for each part; all run in parallel. Sensors are listened to for 1.5 s, and a caller should not wait longer."""
_FINDINGS_S = 4.5
"""Limit for the checks of `ros2_nav_check`, which listen for 2 s."""
_OLD_COSTMAP_S = 5.0
"""Nav2 publishes the costmap once a second, some robots once in two seconds."""
_LONGEST_AGE_S = 1e6
"""A larger difference between a stamp and now means that either the stamp or now is simulated time."""


async def health_of(robot: Robot, action: str) -> list[str]:
    """Return sentences on problems, localisation and transforms with their age, costmaps with theirs, sensors, servers
    and base. Raises no `RobotError`."""
    try:
        topics = list(await robot.graph.topics())
    except RobotError as error:
        return [f"The topics could not be read: {error.message}"]
    parts = await asyncio.gather(
        _within(_localisation(robot), "Where the robot is"),
        _within(_costmap(robot, topics, action), "The costmap"),
        _within(_local(robot, topics, action), "The local costmap"),
        _within(_sensors(robot, topics), "The sensors"),
        _within(_servers(robot), "The servers of Nav2"),
        _within(_base(robot), "The base"),
        _within(_found(robot, action), "What may hold it up", _FINDINGS_S),
    )
    *others, found = parts
    return [*found, *(line for lines in others for line in lines)]


async def _within(part: Awaitable[list[str]], what: str, within_s: float = _PART_S) -> list[str]:
    try:
        return await asyncio.wait_for(part, within_s)
    except asyncio.TimeoutError:
        return [f"{what} could not be determined within {within_s:g} s."]
    except RobotError as error:
        return [f"{what} could not be determined: {error.message}"]


async def _localisation(robot: Robot) -> list[str]:
    where = await whereabouts(robot, MAP_FRAME)
    if where.trouble:
        return [f"The robot's place is unknown: {where.trouble.rstrip('.')}."]
    age = "" if where.age_s is None else f", {where.age_s:.2f} s old"
    return [f"Localised: {named(where.base)} is at ({where.x_m:.2f}, {where.y_m:.2f}) in {named(where.frame)}{age}."]


async def _costmap(robot: Robot, topics: Sequence[TopicRow], action: str) -> list[str]:
    grid, topic, ages = await costmap_of(robot, topics, action)
    if grid is None or "costmap" not in topic:
        return [ages or "No global costmap was received."]
    if ages:
        return [ages]
    stamp = grid.header.stamp
    age_s = (robot.now_ns() - stamp.sec * 1_000_000_000 - stamp.nanosec) / 1e9
    if not 0 <= age_s < _LONGEST_AGE_S:
        return [f"The costmap {named(topic)} is there."]
    late = age_s > _OLD_COSTMAP_S
    return [f"The costmap {named(topic)} is {age_s:.1f} s old{': it is not updated' if late else ''}."]


async def _local(robot: Robot, topics: Sequence[TopicRow], action: str) -> list[str]:
    local: Local | None = await local_of(robot, topics, action)
    return [f"{local}."] if local else []


async def _sensors(robot: Robot, topics: Sequence[TopicRow]) -> list[str]:
    quiet = await sensors_of(robot, topics)
    return [f"{listed(quiet, 3)} {'is' if len(quiet) == 1 else 'are'} silent."] if quiet else []


async def _found(robot: Robot, action: str) -> list[str]:
    evidence, _ = await read_evidence(robot, NEEDS, None, action)
    return [str(finding) for finding in nav_findings_in(evidence)]


async def _servers(robot: Robot) -> list[str]:
    inactive = await inactive_servers(robot)
    return [f"Not every server of Nav2 is active: {'; '.join(inactive)}."] if inactive else []


async def _base(robot: Robot) -> list[str]:
    found = await base_of(robot)
    return [*found.sends, *found.others, *found.limits]
