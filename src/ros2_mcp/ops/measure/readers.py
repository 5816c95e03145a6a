"""Reads what checks need of a live robot beside the flows of its topics: each part once, all at the same time.

A part that cannot be read, or not in time, is None and is told; it takes nothing from the others.
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
"""Nodes that are asked for their parameters and services: more than most robots have, a second for the bridge."""
_AT_A_TIME = 6
"""Nodes that are asked together: the questions should not weigh on the robot."""
_ANSWER_S = 1.5
"""For one node: one that spins answers within milliseconds."""
_GIVEN_UP_S = 6.0
"""For a part as a whole: the check itself listens for three seconds."""
_PART_READ_S = 5.5
"""For the nodes of a part: what was read until then is judged, and the others are named."""
_MOST_NAMED = 5
"""Nodes that did not answer, in one note."""
_NOT_SEEN: Mapping[Need, str] = {
    "parameters": "use_sim_time and the ranges of parameters",
    "servers": "which services they offer",
    "lifecycle": "states of lifecycle nodes",
    "ros2_control": "controllers and hardware",
    "robot": "what ros2_robot finds",
}
"""What was not looked at where a part, or that of some nodes, was not read."""
_LEAST_FRAMES_S = 2.0
"""Frames are listened to for so long: what is told once a second is then no surprise."""
_logger = logging.getLogger(__name__)


async def read(
    needs: Collection[Need], robot: Robot | None, source: Source, graph: GraphSnapshot
) -> tuple[Mapping[str, Any], Sequence[str]]:
    """The parts of the evidence by their names, and the names of those that could not be read.

    Of a recording, and without a robot, there are frames alone.
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
    """None where nobody publishes frames: a robot without is healthy, and what is silent is told of the topic."""
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
    """Those of every node that answers; the others are told in `missed`."""

    async def of(node: str) -> Sequence[Parameter]:
        return await all_of(robot, node)

    return await _of_each("parameters", _nodes(graph, once=True), of, missed)


async def _servers(robot: Robot, graph: GraphSnapshot, missed: list[str]) -> Mapping[str, Sequence[str]]:
    """By service, the nodes that offer it."""

    async def of(node: str) -> Sequence[str]:
        return [row.name for row in (await robot.graph.node(node)).servers]

    found: dict[str, list[str]] = {}
    for node, services in (await _of_each("servers", _nodes(graph), of, missed)).items():
        for service in services:
            found.setdefault(service, []).append(node)
    return found


async def _navigation(robot: Robot, graph: GraphSnapshot) -> Sequence[NavFinding]:
    """Nothing is read of a robot without Nav2."""
    if not NavEvidence(graph=graph).is_nav2:
        return ()
    return nav_findings_in((await read_evidence(robot, NEEDS))[0])


def _nodes(graph: GraphSnapshot, *, once: bool = False) -> list[str]:
    """The robot's nodes; `once`: without names that several share, of which nobody knows which one answers."""
    nodes = [node for node in graph.nodes or () if is_of_robot(node) and node != names.UNKNOWN_NODE]
    return [node for node in dict.fromkeys(nodes) if not once or nodes.count(node) == 1]


async def _of_each(
    need: Need, nodes: Sequence[str], of: Callable[[str], Awaitable[Any]], missed: list[str]
) -> dict[str, Any]:
    """What each node answers; those that did not in time, and so what was not looked at, are told in `missed`."""
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
            except RobotError:  # it has left, or has no such services
                without.add(node)

    with anyio.move_on_after(_PART_READ_S):
        await asyncio.gather(*map(asked, nodes[:_MOST_NODES]))
    if late := [node for node in nodes if node not in found and node not in without]:
        missed.append(f"{_NOT_SEEN[need]} of {counted(len(late), 'node')} ({listed(late, _MOST_NAMED)})")
    return found
