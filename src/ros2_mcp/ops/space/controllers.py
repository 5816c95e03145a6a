"""The controllers of a robot in brief: what moves it first, what is not active said so."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from typing import Any

from ros2_mcp.model.errors import RobotError, UnknownInterface
from ros2_mcp.model.text import named
from ros2_mcp.ops.sources.source import GraphSnapshot
from ros2_mcp.robot import Robot

LIST_CONTROLLERS = "/list_controllers"
"""The service of a controller manager, below its name."""
_LIST = "controller_manager_msgs/srv/ListControllers"
_ANSWER_S = 1.0
"""One that is alive answers within milliseconds, and the whole answer is to be there in two seconds."""
_ACTION = "/follow_joint_trajectory"
_TELLS = ("broadcaster", "status")
"""In the type of a controller that moves nothing: it only publishes."""


async def listed_controllers(robot: Robot, graph: GraphSnapshot) -> Mapping[str, Sequence[Mapping[str, Any]]]:
    """What each controller manager says of its controllers, by its node; empty where none is there, or answers.

    Raises:
        UnknownInterface: where controller_manager_msgs is not installed.
    """
    found: dict[str, Sequence[Mapping[str, Any]]] = {}

    async def ask(service: str) -> None:
        try:
            asked = robot.ask_service(service, _LIST, {}, timeout_s=_ANSWER_S)
            answer = await robot.fields_of(await asyncio.wait_for(asked, _ANSWER_S))
            found[service.rpartition("/")[0]] = answer["controller"]
        except UnknownInterface:
            raise
        except (RobotError, asyncio.TimeoutError):  # one manager that does not answer takes nothing from another
            pass

    services = [name for name in graph.services or () if name.endswith(LIST_CONTROLLERS)]
    await asyncio.gather(*map(ask, services[:2]))
    return found


def controllers_in_words(
    graph: GraphSnapshot, managed: Mapping[str, Sequence[Mapping[str, Any]]], *, is_controlled: bool
) -> list[str]:
    """Those that move something first, each with its action; without a manager's answer what the graph tells."""
    follow = {
        one.topic.rpartition("/_action/")[0]
        for one in graph.topics.values()
        if any(kind.startswith("control_msgs/action/") for kind in one.types)
    }
    either = {name: _with_topic(graph, name) for name in follow}
    if not managed:
        own = {name for name in graph.nodes or () if is_controlled and name.endswith(("_controller", "_broadcaster"))}
        alone = {name for name in own if not any(one.startswith(f"{name}/") for one in follow)}
        return [either.get(name, named(name)) for name in sorted(follow | alone)]
    lines: list[tuple[int, str]] = []
    told = set[str]()
    for listed_by, controllers in managed.items():
        for one in controllers:
            node = f"{listed_by.rpartition('/')[0]}/{one['name']}"
            action = next((name for name in sorted(follow) if name.startswith(f"{node}/")), "")
            told.add(action)
            is_active, kind = one["state"] == "active", str(one["type"]).rpartition("/")[2]
            tells = any(word in kind.lower() for word in _TELLS)
            state = "" if is_active else f" is {named(one['state'])}"
            line = f"{either.get(action) or named(node)} {named(kind)}{state}" if not tells else f"{named(node)}{state}"
            lines.append((tells * 4 + (not is_active) * 2 + (not action), line))
    lines += [(0, either[action]) for action in sorted(follow - told)]
    return [line for _, line in sorted(lines, key=lambda one: one[0])]


def _with_topic(graph: GraphSnapshot, action: str) -> str:
    """An action for trajectories, and whether its controller takes them on its topic, too."""
    topic = f"{action.rpartition('/')[0]}/joint_trajectory"
    return f"{named(action)}{' (or joint_trajectory)' if topic in graph.topics else ''}"


def in_groups(lines: Sequence[str]) -> list[str]:
    """The same, shorter: those that take the same, or say nothing more than their names, in one line."""
    groups: dict[str, list[str]] = {}
    for line in lines:
        name, mark, rest = line.partition(_ACTION)
        groups.setdefault(f"{mark}{rest}".lstrip("/") if mark else line.partition(" ")[2], []).append(
            name if mark else line.partition(" ")[0]
        )
    return [f"{', '.join(names)}{f': {what}' if what else ''}" for what, names in groups.items()]
