"""Find the nodes that would carry out an order. If several nodes serve a service or an action, each carries it out."""

from __future__ import annotations

from collections.abc import Sequence
from time import monotonic
from weakref import WeakKeyDictionary

from ros2_mcp.model.errors import BadInput, RobotError
from ros2_mcp.model.text import counted, listed, named
from ros2_mcp.robot import Robot
from ros2_mcp.robot.graph import Graph

_KNOWN_S = 2.0
"""How long a service is assumed to have one server after that was seen: repeated calls ask the graph only once."""
_MOST_KNOWN = 256
_MOST_NAMED = 4

_alone: WeakKeyDictionary[Graph, dict[str, float]] = WeakKeyDictionary()
"""For each robot: service → when it was last seen to have one server (monotonic, in s)."""


async def servers_of(robot: Robot, service: str) -> Sequence[str]:
    """Return the nodes that serve a service if there are several, else none. Raises no `RobotError`.

    Nodes with the same name count as one: a node that was killed and restarted is listed twice until its lease expires.
    """
    known = _alone.setdefault(robot.graph, {})
    if monotonic() - known.get(service, -_KNOWN_S) < _KNOWN_S:
        return ()
    try:
        found = await robot.graph.servers(service)
    except RobotError:  # the call itself will report what is wrong
        return ()
    if len(set(found)) > 1:
        return found
    if len(known) >= _MOST_KNOWN:
        known.clear()
    if found:
        known[service] = monotonic()
    return ()


async def servers_of_action(robot: Robot, action: str) -> Sequence[str]:
    """Return the nodes that serve an action if there are several, else none. Raises no `RobotError`."""
    return await servers_of(robot, f"{action}/_action/send_goal")


def in_words(name: str, servers: Sequence[str]) -> str:
    """Return the clause "N nodes serve NAME (their names)", without a full stop."""
    return f"{counted(len(servers), 'node')} serve {named(name)} ({listed(sorted(servers), _MOST_NAMED)})"


async def check_one_server(robot: Robot, action: str, hint: str) -> None:
    """Raise `BadInput` if several nodes would carry out a goal."""
    if servers := await servers_of_action(robot, action):
        raise BadInput(f"{in_words(action, servers)}: each would carry out the goal. Nothing was sent.", hint)
