"""Names of the present graph, or none if they take too long: for completions, and for prompts that name topics."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping

from ros2_mcp.model import names
from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.graph import OF_EVERY_NODE
from ros2_mcp.model.text import is_name
from ros2_mcp.robot import Robot
from ros2_mcp.robot.resolution import is_infrastructure

PATIENCE_S = 1.0
"""A completion that arrives later is of no use to a person who types."""
_ACTION_SERVICE = "/_action/send_goal"
"""The suffix of the name of an action's service; every action has exactly one."""


async def live_names(robot: Robot, kind: str, within_s: float = PATIENCE_S) -> list[str]:
    """Return the names of a kind, sorted: the robot's own names before names that every ROS system has.

    Args:
        robot: the robot.
        kind: `topic`, `service`, `node`, `action`, `message_type` or `interface`.
        within_s: how long to wait for the robot, and for discovery to settle.

    Returns:
        Nothing for another kind, or if the robot does not answer in time.
    """
    if kind not in _LISTS:
        return []
    try:
        found = await asyncio.wait_for(_LISTS[kind](robot, within_s), within_s)
    except (TimeoutError, asyncio.TimeoutError, RobotError):  # two time-out types until Python 3.11
        return []
    return [name for name in found if is_name(name)]  # a recording may have other names, which no tool accepts


async def topic_types(robot: Robot, topic: str) -> list[str]:
    """Return the types of one topic; none if it is not known within `PATIENCE_S`."""
    try:
        found = await asyncio.wait_for(robot.graph.topics(PATIENCE_S), PATIENCE_S)
        full_name = await robot.graph.name_of(topic)
    except (TimeoutError, asyncio.TimeoutError, RobotError):
        return []
    return [kind for row in found if row.name == full_name for kind in row.types]


def is_of_every_node(topic: str) -> bool:
    """Return whether every ROS system has the topic, such as /rosout, so that it says nothing about this robot."""
    return topic in OF_EVERY_NODE


async def _topics(robot: Robot, within_s: float) -> list[str]:
    visible = [row.name for row in await robot.graph.topics(within_s) if not names.is_hidden(row.name)]
    return sorted(visible, key=lambda name: (name in OF_EVERY_NODE, name))


async def _services(robot: Robot, within_s: float) -> list[str]:
    visible = [row for row in await robot.graph.services(within_s) if not names.is_hidden(row.name)]
    return [row.name for row in sorted(visible, key=lambda row: (is_infrastructure(row.name, row.types), row.name))]


async def _nodes(robot: Robot, within_s: float) -> list[str]:
    others = {row.name for row in await robot.graph.nodes(within_s)}.difference(robot.graph.own_nodes)
    return sorted(name for name in others if name.startswith("/") and not names.is_hidden(name))


async def _actions(robot: Robot, within_s: float) -> list[str]:
    services = [row.name for row in await robot.graph.services(within_s)]
    return sorted(name.removesuffix(_ACTION_SERVICE) for name in services if name.endswith(_ACTION_SERVICE))


async def _message_types(robot: Robot, within_s: float) -> list[str]:
    """Return the types of the topics, then every other message type that is installed."""
    in_use = sorted({kind for row in await robot.graph.topics(within_s) for kind in row.types})
    in_use = [name for name in in_use if not names.is_derived(name)]
    installed = [name for name in await robot.graph.interfaces(within_s) if "/msg/" in name]
    return [*in_use, *(name for name in installed if name not in set(in_use))]


_LISTS: Mapping[str, Callable[[Robot, float], Awaitable[list[str]]]] = {
    "topic": _topics,
    "service": _services,
    "node": _nodes,
    "action": _actions,
    "message_type": _message_types,
    "interface": lambda robot, within_s: robot.graph.interfaces(within_s),
}
"""Kind of name → the function that lists the names of that kind, within a time in seconds."""
