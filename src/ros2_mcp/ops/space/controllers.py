"""The controllers of a robot in brief: what moves it first, what is not active said so."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
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
_SPAWNER = re.compile(r"(ros2_control_|hardware_)?(un)?spawner_")
"""Nodes of the scripts that load controllers, as the package controller_manager names them."""
_TELLS = ("broadcaster", "status")
"""In the type of a controller that moves nothing: it only publishes."""


@dataclass(frozen=True, slots=True)
class Controller:
    """A controller by its full name; `type` is empty of those that only publish, `state` of those that are active."""

    name: str
    type: str = ""
    state: str = ""

    @property
    def line(self) -> str:
        """`/arm_controller JointTrajectoryController is inactive`."""
        kind = f" {named(self.type)}" if self.type else ""
        return f"{named(self.name)}{kind}{f' is {named(self.state)}' if self.state else ''}"


async def listed_hardware(robot: Robot, node: str) -> Sequence[Mapping[str, Any]] | None:
    """What a controller manager says of its hardware components; None where it does not tell."""
    service, kind = f"{node}/list_hardware_components", "controller_manager_msgs/srv/ListHardwareComponents"
    try:
        asked = robot.ask_service(service, kind, {}, timeout_s=_ANSWER_S)
        return (await robot.fields_of(await asyncio.wait_for(asked, _ANSWER_S)))["component"]
    except (RobotError, asyncio.TimeoutError):
        return None


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


def controllers_of(
    graph: GraphSnapshot, managed: Mapping[str, Sequence[Mapping[str, Any]]], *, is_controlled: bool
) -> list[Controller]:
    """Those that move something first; without a manager's answer what the graph tells."""
    moved = {name for name in _movers(graph) if graph.nodes is None or name in graph.nodes}
    if not managed:
        own = {name for name in graph.nodes or () if is_controlled and _is_controller(name)}
        return [Controller(name) for name in sorted(moved | own)]
    found: list[tuple[int, Controller]] = []
    for listed_by, controllers in managed.items():
        for one in controllers:
            node = f"{listed_by.rpartition('/')[0]}/{one['name']}"
            is_active, kind = one["state"] == "active", str(one["type"]).rpartition("/")[2]
            tells = any(word in kind.lower() for word in _TELLS)
            rank = tells * 4 + (not is_active) * 2 + (node not in moved)
            found.append((rank, Controller(node, "" if tells else kind, "" if is_active else str(one["state"]))))
    known = {controller.name for _, controller in found}
    found += [(0, Controller(name)) for name in sorted(moved - known)]
    return [controller for _, controller in sorted(found, key=lambda one: one[0])]


def idle_movers(graph: GraphSnapshot, managed: Mapping[str, Sequence[Mapping[str, Any]]]) -> list[str]:
    """That no controller that takes goals is active, as after a protective stop; empty where one is, or none exists."""
    movers = _movers(graph)
    are_idle = bool(movers) and movers <= idle_nodes(managed)
    return ["No controller that moves joints is active."] if are_idle else []


def idle_nodes(managed: Mapping[str, Sequence[Mapping[str, Any]]]) -> set[str]:
    """The nodes of the controllers that are not active."""
    return {
        f"{listed_by.rpartition('/')[0]}/{one['name']}"
        for listed_by, controllers in managed.items()
        for one in controllers
        if one["state"] != "active"
    }


def _is_controller(node: str) -> bool:
    """By its name; a spawner is none, which waits for the manager: `spawner_arm_controller`."""
    last = node.rpartition("/")[2]
    return last.endswith(("_controller", "_broadcaster")) and not _SPAWNER.match(last)


def _movers(graph: GraphSnapshot) -> set[str]:
    """Controllers that have an action."""
    return {
        one.topic.rpartition("/_action/")[0].rpartition("/")[0]
        for one in graph.topics.values()
        if any(kind.startswith("control_msgs/action/") for kind in one.types)
    } - {""}
