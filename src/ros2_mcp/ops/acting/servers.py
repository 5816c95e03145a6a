"""Who would carry out an order: a service or an action that several nodes serve is carried out by each of them."""

from __future__ import annotations

from collections.abc import Sequence
from time import monotonic
from weakref import WeakKeyDictionary

from ros2_mcp.model.errors import BadInput, RobotError
from ros2_mcp.model.text import counted, listed, named
from ros2_mcp.robot import Robot
from ros2_mcp.robot.graph import Graph

_KNOWN_S = 2.0
"""So long it is taken that one node serves a service: who calls again and again asks the graph once in that time."""
_MOST_KNOWN = 256
_MOST_NAMED = 4

_alone: WeakKeyDictionary[Graph, dict[str, float]] = WeakKeyDictionary()
"""Of each robot: when a service was last seen to have one server (monotonic, in s)."""


async def servers_of(robot: Robot, service: str) -> Sequence[str]:
    """The nodes that serve a service, where there are several; else empty. Raises no `RobotError`.

    Nodes of one name count as one: a node that was killed and started again is listed twice until its lease is over.
    """
    known = _alone.setdefault(robot.graph, {})
    if monotonic() - known.get(service, -_KNOWN_S) < _KNOWN_S:
        return ()
    try:
        found = await robot.graph.servers(service)
    except RobotError:  # the call itself tells what is wrong
        return ()
    if len(set(found)) > 1:
        return found
    if len(known) >= _MOST_KNOWN:
        known.clear()
    if found:
        known[service] = monotonic()
    return ()


async def servers_of_action(robot: Robot, action: str) -> Sequence[str]:
    """The same of an action."""
    return await servers_of(robot, f"{action}/_action/send_goal")


def in_words(name: str, servers: Sequence[str]) -> str:
    """That several nodes serve a service or an action, as a sentence without its end."""
    return f"{counted(len(servers), 'node')} serve {named(name)} ({listed(sorted(servers), _MOST_NAMED)})"


async def check_one_server(robot: Robot, action: str, hint: str) -> None:
    """Raises `BadInput` where several nodes would carry out a goal."""
    if servers := await servers_of_action(robot, action):
        raise BadInput(f"{in_words(action, servers)}: each would carry out the goal. Nothing was sent.", hint)
