"""Lifecycle nodes that are started and stopped together, as Nav2's are by its lifecycle manager."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

from ros2_mcp.model import parameters
from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.nav2 import MANAGE
from ros2_mcp.model.text import counted, listed, named
from ros2_mcp.ops.nodes.own_services import ask_node
from ros2_mcp.robot import Robot

COMMANDS = {"up": 0, "pause": 1, "resume": 2, "reset": 3, "down": 4}
"""Values of the field `command` of a request: STARTUP, PAUSE, RESUME, RESET, SHUTDOWN."""
_ENDING = "/manage_nodes"
_ANSWER_S = 1.0
_MOST_NAMED = 4


@dataclass(frozen=True, slots=True)
class Stack:
    """The nodes that the node `host` starts and stops together, in its order."""

    host: str
    nodes: Sequence[str]

    @property
    def service(self) -> str:
        """The service of the host."""
        return f"{self.host}{_ENDING}"

    def of(self, node: str) -> str:
        """Return a text on a node of the stack: its host, the consequence of changing it
        alone, and what to do instead.
        """
        others = [one for one in self.nodes if one != node]
        return (
            f"{named(node)} belongs to {named(self.host)}, with {counted(len(others), 'other node')} "
            f"({listed(others, _MOST_NAMED)}): Nav2's lifecycle manager takes all of them down when one of them is not "
            f"active any more. Change them together: ros2_nav_recover with stack pause, resume, down or up, or "
            f"{named(self.service)} with command 1, 2, 4 or 0."
        )


async def stacks_of(robot: Robot) -> list[Stack]:
    """Return all stacks whose host reports its nodes. Raises no `RobotError`."""
    try:
        rows = [row.name for row in await robot.graph.services() if MANAGE in row.types]
    except RobotError:
        return []
    hosts = sorted(name.removesuffix(_ENDING) for name in rows if name.endswith(_ENDING))
    found = await asyncio.gather(*(_nodes(robot, host) for host in hosts))
    return [Stack(host, nodes) for host, nodes in zip(hosts, found, strict=True) if nodes]


async def stack_of(robot: Robot, node: str) -> Stack | None:
    """Return the stack to which a node belongs; None if it belongs to none."""
    return next((stack for stack in await stacks_of(robot) if node in stack.nodes), None)


async def _nodes(robot: Robot, host: str) -> list[str]:
    kind = "rcl_interfaces/srv/GetParameters"
    try:
        answer = await ask_node(robot, host, kind, {"names": ["node_names"]}, timeout_s=_ANSWER_S, wait_s=0.0)
        (value,) = (await robot.fields_of(answer))["values"]
    except (RobotError, ValueError):
        return []
    names: object = parameters.value_of(value)
    namespace = host.rpartition("/")[0]
    given = [str(one) for one in cast("Sequence[object]", names)] if isinstance(names, (list, tuple)) else []
    return [one if one.startswith("/") else f"{namespace}/{one}" for one in given]
