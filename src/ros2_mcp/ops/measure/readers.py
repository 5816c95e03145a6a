"""Read the data of a live robot that checks need besides its topics: each part once, all at the same time.

A part that fails or takes too long is omitted and reported; other parts are not affected.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable, Collection, Mapping, Sequence
from typing import Any

import anyio

from ros2_mcp.model import names
from ros2_mcp.model.errors import NoTransform, RobotError, TimedOut, UnknownInterface
from ros2_mcp.model.text import counted, listed, quoted
from ros2_mcp.ops.measure.evidence import Need, Ros2Control
from ros2_mcp.ops.navigation.checks import NEEDS, nav_findings_in
from ros2_mcp.ops.navigation.evidence import NavEvidence, NavFinding
from ros2_mcp.ops.navigation.readers import read_evidence
from ros2_mcp.ops.nodes.lifecycle import LifecycleState
from ros2_mcp.ops.nodes.lifecycle import states as lifecycle_states
from ros2_mcp.ops.nodes.parameters import Parameter, all_of
from ros2_mcp.ops.sources.source import GraphSnapshot, Source
from ros2_mcp.ops.space.controllers import listed_controllers, listed_hardware
from ros2_mcp.ops.space.robot import unhealthy_besides
from ros2_mcp.ops.space.tf_tree import FrameProblem, tf_tree
from ros2_mcp.robot import Robot
from ros2_mcp.robot.seen import is_of_robot
from ros2_mcp.robot.transforms import TF, TF_STATIC

_MOST_NODES = 60
"""The most nodes queried for parameters and services: more than most robots have; it takes the bridge a second."""
_AT_A_TIME = 6
"""The most nodes queried at the same time, to limit the load on the robot."""
_ANSWER_S = 1.5
"""Time-out for one node: a node that spins answers within milliseconds."""
_GIVEN_UP_S = 6.0
"""Time-out for a whole part: the check itself measures for three seconds."""
_PART_READ_S = 5.5
"""Time-out for the nodes of a part: answers up to then are judged, and the other nodes are named."""
_NEVER_SPUN = "_rclcpp_node"
"""The end of the names of nodes inside Nav2's servers that never answer: their executor runs only while the server
waits for another one."""
_MOST_NAMED = 5
"""The most nodes without an answer named in one note."""
_NOT_SEEN: Mapping[Need, str] = {
    "parameters": "use_sim_time and the ranges of parameters",
    "servers": "which services they offer",
    "lifecycle": "states of lifecycle nodes",
    "ros2_control": "controllers and hardware",
    "robot": "what ros2_robot finds",
}
"""The data that are missing if a part, or that of some nodes, was not read."""
_LEAST_FRAMES_S = 2.0
"""The least time for which frames are received, so that rates of 1 Hz can be measured."""
_logger = logging.getLogger(__name__)


async def read(
    needs: Collection[Need], robot: Robot | None, source: Source, graph: GraphSnapshot
) -> tuple[Mapping[str, Any], Sequence[str]]:
    """Return the parts of the evidence by their names, and descriptions of the parts that could not be read.

    For a recording, or without a robot, only frames are read.
    """
    missed: list[str] = []
    makers: dict[Need, Callable[[], Awaitable[Any]]] = {"frames": lambda: _frames(source, graph)}
    if robot is not None and source.is_live and not graph.absence:
        makers |= {
            "lifecycle": lambda: _lifecycle(robot),
            "ros2_control": lambda: _ros2_control(robot, graph),
            "parameters": lambda: _parameters(robot, graph, missed),
            "servers": lambda: _servers(robot, graph, missed),
            "robot": lambda: unhealthy_besides(robot, source),
            "navigation": lambda: _navigation(robot, graph),
        }
    found: dict[str, Any] = {}

    async def made(need: Need) -> None:
        try:
            with anyio.move_on_after(max(_GIVEN_UP_S, 2 * source.duration_s)) as scope:
                found[need] = await makers[need]()
            if scope.cancelled_caught:
                missed.append(_NOT_SEEN.get(need, need))
        except UnknownInterface as error:
            missed.append(f"{need} ({error.message})")
        except Exception as error:
            _logger.warning("%s could not be read for the health check", need, exc_info=True)
            missed.append(f"{need} ({quoted(str(error)[:120])})")

    await asyncio.gather(*(made(need) for need in needs if need in makers))
    return found, sorted(missed)


async def _frames(source: Source, graph: GraphSnapshot) -> Sequence[FrameProblem]:
    """Return the problems of frames; none without publishers on /tf or /tf_static: such a robot is healthy, and silence
    of these topics is reported as such.
    """
    topics = [topic for name, topic in graph.topics.items() if name.endswith((TF, TF_STATIC))]
    if not any(topic.publishers for topic in topics):
        return ()
    try:
        duration_s = max(source.duration_s, _LEAST_FRAMES_S) if source.is_live else 0.0
        return (await tf_tree(source, duration_s=duration_s, picture=False)).found
    except NoTransform:
        return ()


async def _lifecycle(robot: Robot) -> Sequence[LifecycleState]:
    return (await lifecycle_states(robot)).nodes


async def _ros2_control(robot: Robot, graph: GraphSnapshot) -> Mapping[str, Ros2Control]:
    listed = await listed_controllers(robot, graph)
    hardware = await asyncio.gather(*(listed_hardware(robot, node) for node in listed))
    return {node: Ros2Control(listed[node], components) for node, components in zip(listed, hardware, strict=True)}


async def _parameters(robot: Robot, graph: GraphSnapshot, missed: list[str]) -> Mapping[str, Sequence[Parameter]]:
    """Return the parameters of every node that answers; the others are added to `missed`."""

    async def of(node: str) -> Sequence[Parameter]:
        return await all_of(robot, node)

    return await _of_each("parameters", _nodes(graph, once=True), of, missed)


async def _servers(robot: Robot, graph: GraphSnapshot, missed: list[str]) -> Mapping[str, Sequence[str]]:
    """Return the nodes that provide each service."""

    async def of(node: str) -> Sequence[str]:
        return [row.name for row in (await robot.graph.node(node)).servers]

    found: dict[str, list[str]] = {}
    for node, services in (await _of_each("servers", _nodes(graph), of, missed)).items():
        for service in services:
            found.setdefault(service, []).append(node)
    return found


async def _navigation(robot: Robot, graph: GraphSnapshot) -> Sequence[NavFinding]:
    """Return the findings on navigation; empty for a robot without Nav2."""
    if not NavEvidence(graph=graph).is_nav2:
        return ()
    return nav_findings_in((await read_evidence(robot, NEEDS))[0])


def _nodes(graph: GraphSnapshot, *, once: bool = False) -> list[str]:
    """Return the robot's nodes; `once`: without names shared by several nodes, as any of these may answer."""
    nodes = [node for node in graph.nodes or () if is_of_robot(node) and node != names.UNKNOWN_NODE]
    nodes = [node for node in nodes if not node.endswith(_NEVER_SPUN)]
    return [node for node in dict.fromkeys(nodes) if not once or nodes.count(node) == 1]


async def _of_each(
    need: Need, nodes: Sequence[str], of: Callable[[str], Awaitable[Any]], missed: list[str]
) -> dict[str, Any]:
    """Return the answer of each node; nodes that did not answer in time are added to `missed`, with the data that are
    missing.
    """
    limit = asyncio.Semaphore(_AT_A_TIME)
    found: dict[str, Any] = {}
    without: set[str] = set()

    async def asked(node: str) -> None:
        async with limit:
            try:
                with anyio.move_on_after(_ANSWER_S):
                    found[node] = await of(node)
            except TimedOut:
                pass
            except RobotError:  # the node has left, or has no such services
                without.add(node)

    with anyio.move_on_after(_PART_READ_S):
        await asyncio.gather(*map(asked, nodes[:_MOST_NODES]))
    if late := [node for node in nodes if node not in found and node not in without]:
        missed.append(f"{_NOT_SEEN[need]} of {counted(len(late), 'node')} ({listed(late, _MOST_NAMED)})")
    return found
