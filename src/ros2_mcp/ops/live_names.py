"""Names of the graph as it is now, quickly or not at all: for completions and for prompts that name what is there."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from ros2_mcp.model import names
from ros2_mcp.model.errors import RobotError
from ros2_mcp.robot import Robot

PATIENCE_S = 1.0
"""Nobody who types waits longer."""
_SETTLING = 0.8
"""The part of the waiting that discovery may take; then what is known so far is told."""
_OF_EVERY_NODE = ("/parameter_events", "/rosout")
_ACTION_SERVICE = "/_action/send_goal"


async def live_names(robot: Robot, kind: str, within_s: float = PATIENCE_S) -> list[str]:
    """The names of a kind, sorted: those of the robot's own before those that every ROS system has.

    Args:
        robot: the robot.
        kind: `topic`, `service`, `node`, `action`, `message_type` or `interface`.
        within_s: how long to wait for the robot, and for discovery to settle.

    Returns:
        Nothing for another kind, or where the robot does not answer in time.
    """
    if kind not in _LISTS:
        return []
    try:
        return await asyncio.wait_for(_LISTS[kind](robot, within_s), within_s)
    except (TimeoutError, asyncio.TimeoutError, RobotError):
        return []


async def topic_types(robot: Robot, topic: str) -> list[str]:
    """The types of one topic; nothing where it is not known within `PATIENCE_S`."""
    try:
        raw = await asyncio.wait_for(_query(robot, "topics", PATIENCE_S), PATIENCE_S)
        wanted = names.absolute(topic)
    except (TimeoutError, asyncio.TimeoutError, RobotError):
        return []
    found: list[list[str]] = [entry[1] for entry in raw["topics"] if entry[0] == wanted]
    return found[0] if found else []


def is_of_every_node(topic: str) -> bool:
    """Whether every ROS system has the topic, so that it tells nothing of this robot."""
    return topic in _OF_EVERY_NODE


async def _query(robot: Robot, op: str, within_s: float) -> Mapping[str, Any]:
    return (await robot.graph.ask(op, settle_s=_SETTLING * within_s, timeout_s=within_s)).ok


async def _topics(robot: Robot, within_s: float) -> list[str]:
    visible = [
        entry[0] for entry in (await _query(robot, "topics", within_s))["topics"] if not names.is_hidden(entry[0])
    ]
    return sorted(visible, key=lambda name: (is_of_every_node(name), name))


async def _services(robot: Robot, within_s: float) -> list[str]:
    every = (await _query(robot, "services", within_s))["services"]
    visible = [(name, types[0]) for name, types in every if not names.is_hidden(name)]
    return [name for name, _ in sorted(visible, key=lambda entry: (_is_infrastructure(entry[1]), entry[0]))]


def _is_infrastructure(service_type: str) -> bool:
    return service_type.startswith(("rcl_interfaces/", "type_description_interfaces/"))


async def _nodes(robot: Robot, within_s: float) -> list[str]:
    every = {names.full_node_name(*entry) for entry in (await _query(robot, "nodes", within_s))["nodes"]}
    return sorted(name for name in every - robot.bridge.nodes if name.startswith("/") and not names.is_hidden(name))


async def _actions(robot: Robot, within_s: float) -> list[str]:
    every = (await _query(robot, "services", within_s))["services"]
    return sorted(name.removesuffix(_ACTION_SERVICE) for name, _ in every if name.endswith(_ACTION_SERVICE))


async def _message_types(robot: Robot, within_s: float) -> list[str]:
    """The types that the topics have, then every other message type that is installed."""
    in_use = sorted({kind for entry in (await _query(robot, "topics", within_s))["topics"] for kind in entry[1]})
    installed = [name for name in await _interfaces(robot, within_s) if "/msg/" in name]
    return [*in_use, *(name for name in installed if name not in set(in_use))]


async def _interfaces(robot: Robot, within_s: float) -> list[str]:
    every = (await robot.graph.ask("interfaces", timeout_s=within_s)).ok["interfaces"]
    return sorted(every)


_LISTS: Mapping[str, Callable[[Robot, float], Awaitable[list[str]]]] = {
    "topic": _topics,
    "service": _services,
    "node": _nodes,
    "action": _actions,
    "message_type": _message_types,
    "interface": _interfaces,
}
