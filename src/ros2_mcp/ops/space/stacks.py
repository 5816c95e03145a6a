"""Detection of well-known stacks (Nav2, MoveIt, ros2_control and others) by their nodes, types and services."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.nav2 import COSTMAPS, NAVIGATION_NODES
from ros2_mcp.ops.nodes.own_services import ask_node
from ros2_mcp.ops.nodes.stacks import stacks_of as managed_stacks
from ros2_mcp.ops.sources.source import GraphSnapshot, Source
from ros2_mcp.robot import Robot

_GET_STATE = "lifecycle_msgs/srv/GetState"
_ANSWER_S = 1.0
"""Time-out of a call: a node that spins answers within milliseconds."""


def stacks_of(graph: GraphSnapshot) -> list[str]:
    """Return the names of the stacks found in the graph, in a fixed order."""
    nodes = {name.rpartition("/")[2] for name in graph.nodes or ()}
    types = {kind for one in graph.topics.values() for kind in one.types}
    services = {name.rpartition("/")[2] for name in graph.services or ()}
    return [
        name
        for name, is_there in (
            ("Nav2", "bt_navigator" in nodes or any(kind.startswith("nav2_msgs/action/Navigate") for kind in types)),
            ("MoveIt", "move_group" in nodes or any(kind.startswith("moveit_msgs/action/") for kind in types)),
            ("ros2_control", "controller_manager" in nodes or "list_controllers" in services),
            ("MAVROS", "mavros_msgs/msg/State" in types),
            ("slam_toolbox", "slam_toolbox" in nodes),
            ("amcl", "amcl" in nodes),
        )
        if is_there
    ]


async def nav2_active(robot: Robot, source: Source, graph: GraphSnapshot) -> str:
    """Return the number of active Nav2 servers, such as `7 of 7 active`: those that its lifecycle managers start, as
    for `ros2_nav_check`, else those that have a state. Empty for a recording, or without lifecycle nodes.
    """
    offered = [name.rpartition("/")[0] for name, types in (graph.services or {}).items() if _GET_STATE in types]
    servers = {*NAVIGATION_NODES, "docking_server"} - {*COSTMAPS}
    nodes = [node for node in offered if node.rpartition("/")[2] in servers]
    if not source.is_live or not nodes:
        return ""
    managed = [node for stack in await managed_stacks(robot) for node in stack.nodes]
    nodes = list(dict.fromkeys(managed)) or nodes

    async def is_active(node: str) -> bool:
        try:
            answer = await ask_node(robot, node, _GET_STATE, {}, timeout_s=_ANSWER_S, wait_s=_ANSWER_S / 2)
            return (await robot.fields_of(answer))["current_state"]["label"] == "active"
        except RobotError:
            return False

    active = await asyncio.gather(*map(is_active, nodes))
    return f"{sum(active)} of {len(nodes)} active"


def with_active(stacks: Sequence[str], active: str) -> list[str]:
    """Return the names of the stacks; Nav2 with its number of active servers, AMCL among them, and with the tool that
    explains why some are not active.
    """
    why = " (ros2_health_check or ros2_nav_check says why)" if _are_some_idle(active) else ""
    told = [stack for stack in stacks if stack != "amcl"] if "Nav2" in stacks and active else stacks
    return [f"Nav2: {active}{why}" if stack == "Nav2" and active else stack for stack in told]


def idle_servers(active: str) -> list[str]:
    """Return a sentence on Nav2's servers if some are not active."""
    return [f"Of Nav2's servers, {active}."] if _are_some_idle(active) else []


def _are_some_idle(active: str) -> bool:
    count, _, whole = active.removesuffix(" active").partition(" of ")
    return count != whole and bool(active)
