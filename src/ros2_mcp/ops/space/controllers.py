"""The ros2_control controllers of a robot: first the controllers that command joints; inactive controllers are marked
as such.
"""

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
"""The service by which a controller manager lists its controllers, below the manager's name."""
_LIST = "controller_manager_msgs/srv/ListControllers"
_ANSWER_S = 1.0
"""Time-out of a call: a live manager answers within milliseconds, and the whole tool result is due within 2 s."""
_SPAWNER = re.compile(r"(ros2_control_|hardware_)?(un)?spawner_")
"""Names of the spawner nodes of the package controller_manager."""
_TELLS = ("broadcaster", "status")
"""Words in the type of a controller that only publishes and commands no joint."""


@dataclass(frozen=True, slots=True)
class Controller:
    """A controller. `name` is its full name; `type` is empty if it only publishes; `state` is empty if it is active."""

    name: str
    type: str = ""
    state: str = ""

    @property
    def line(self) -> str:
        """The controller in words, such as `/arm_controller JointTrajectoryController is inactive`."""
        kind = f" {named(self.type)}" if self.type else ""
        return f"{named(self.name)}{kind}{f' is {named(self.state)}' if self.state else ''}"


async def listed_hardware(robot: Robot, node: str) -> Sequence[Mapping[str, Any]] | None:
    """Return the hardware components listed by a controller manager; None if it does not answer within 1 s."""
    service, kind = f"{node}/list_hardware_components", "controller_manager_msgs/srv/ListHardwareComponents"
    try:
        asked = robot.ask_service(service, kind, {}, timeout_s=_ANSWER_S)
        return (await robot.fields_of(await asyncio.wait_for(asked, _ANSWER_S)))["component"]
    except (RobotError, asyncio.TimeoutError):
        return None


async def listed_controllers(robot: Robot, graph: GraphSnapshot) -> Mapping[str, Sequence[Mapping[str, Any]]]:
    """Return the controllers listed by each controller manager, by the manager's node name; empty if no manager
    answers.

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
        except (RobotError, asyncio.TimeoutError):  # a manager that fails does not prevent the others from answering
            pass

    services = [name for name in graph.services or () if name.endswith(LIST_CONTROLLERS)]
    await asyncio.gather(*map(ask, services[:2]))
    return found


def controllers_of(
    graph: GraphSnapshot, managed: Mapping[str, Sequence[Mapping[str, Any]]], *, is_controlled: bool
) -> list[Controller]:
    """Return the controllers, first the controllers that command joints. Without an answer of a manager, they are found
    in the graph.
    """
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
    """Return a warning if controllers that take goals exist and none is active, as after a protective stop; else
    empty.
    """
    movers = _movers(graph)
    are_idle = bool(movers) and movers <= idle_nodes(managed)
    return ["No controller that moves joints is active."] if are_idle else []


def idle_nodes(managed: Mapping[str, Sequence[Mapping[str, Any]]]) -> set[str]:
    """Return the nodes of the controllers that are not active."""
    return {
        f"{listed_by.rpartition('/')[0]}/{one['name']}"
        for listed_by, controllers in managed.items()
        for one in controllers
        if one["state"] != "active"
    }


def _is_controller(node: str) -> bool:
    """Return whether a node's name is that of a controller; spawners (`spawner_arm_controller`) are excluded."""
    last = node.rpartition("/")[2]
    return last.endswith(("_controller", "_broadcaster")) and not _SPAWNER.match(last)


def _movers(graph: GraphSnapshot) -> set[str]:
    """Return the nodes of the controllers that provide an action of control_msgs."""
    return {
        one.topic.rpartition("/_action/")[0].rpartition("/")[0]
        for one in graph.topics.values()
        if any(kind.startswith("control_msgs/action/") for kind in one.types)
    } - {""}
