"""Lifecycle nodes: their state, what is possible now, and changing it by name."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Sequence
from dataclasses import dataclass
from typing import Any

from ros2_mcp.model import names
from ros2_mcp.model.commands import ChangeState
from ros2_mcp.model.errors import BadInput, NotFound, RobotError, TimedOut
from ros2_mcp.ops.nodes.list import ask_node
from ros2_mcp.robot import Robot
from ros2_mcp.robot.translation import CHANGE_STATE

TIMEOUT_S = 5.0
"""A node that spins answers within milliseconds."""
CHANGE_S = 30.0
"""A transition may start hardware: drivers take seconds to configure."""
_APPEAR_S = 1.0
"""For a service of a node that has only just come up."""


@dataclass(frozen=True, slots=True)
class LifecycleState:
    """The state of one lifecycle node and the transitions that are possible now, by name."""

    node: str
    state: str
    transitions: Sequence[str]
    error: str = ""

    def summary(self) -> str:
        """One line."""
        possible = ", ".join(self.transitions) or "nothing"
        return f"{self.node}: " + (self.error or f"{self.state}; possible now: {possible}.")


@dataclass(frozen=True, slots=True)
class LifecycleStates:
    """The states of several lifecycle nodes."""

    nodes: Sequence[LifecycleState]

    def summary(self) -> str:
        """A line for each node."""
        return "\n".join(node.summary() for node in self.nodes) or "There is no lifecycle node."


@dataclass(frozen=True, slots=True)
class Transition:
    """What became of a transition: the states before and after, and what is possible now."""

    node: str
    transition: str
    successful: bool
    state_before: str
    state: str
    transitions: Sequence[str]

    def summary(self) -> str:
        """One line."""
        outcome = "done" if self.successful else "failed"
        return f"{self.node}: {self.transition} {outcome}; {self.state_before} → {self.state}."


async def states(robot: Robot, nodes: Sequence[str] = ()) -> LifecycleStates:
    """The states of the named nodes, or of every lifecycle node; an `error` of one leaves the others."""
    wanted = [names.absolute(node, "node") for node in nodes] or await _lifecycle_nodes(robot)
    return LifecycleStates(await asyncio.gather(*(_state_or_error(robot, node) for node in wanted)))


async def change(robot: Robot, node: str, transition: str) -> Transition:
    """Makes a transition that is possible now, such as `configure` or `activate`.

    Raises:
        NotFound: if the node is not there or has no lifecycle.
        BadInput: if the transition is not possible now; names those that are.
    """
    node = names.absolute(node, "node")
    before = await _state(robot, node)
    if transition not in before.transitions:
        possible = ", ".join(before.transitions) or "nothing"
        raise BadInput(f"{node} is {before.state}: {transition!r} is not possible.", f"Possible now: {possible}.")
    available = await _call(robot, node, "GetAvailableTransitions")
    offered = [entry["transition"] for entry in available["available_transitions"]]
    chosen = next((entry for entry in offered if entry["label"] == transition), {"id": 0, "label": transition})
    command = ChangeState(
        principal=robot.principal,
        name=node,
        through=f"{node}/change_state",
        type=CHANGE_STATE,
        value={"transition": chosen},
        transition=transition,
        transition_id=int(chosen["id"]),
        timeout_s=CHANGE_S,
        wait_s=_APPEAR_S,
    )
    response = await _told(robot, node, _done(robot, command), CHANGE_S)
    after = await _state(robot, node)
    return Transition(node, transition, response["success"], before.state, after.state, after.transitions)


async def _lifecycle_nodes(robot: Robot) -> list[str]:
    ending, kind = "/change_state", CHANGE_STATE
    services = [row for row in await robot.graph.services() if row.name.endswith(ending)]
    return sorted(row.name.removesuffix(ending) for row in services if kind in row.types)


async def _state_or_error(robot: Robot, node: str) -> LifecycleState:
    try:
        return await _state(robot, node)
    except RobotError as error:
        return LifecycleState(node, "unknown", (), str(error))


async def _state(robot: Robot, node: str) -> LifecycleState:
    current, available = await asyncio.gather(
        _call(robot, node, "GetState"), _call(robot, node, "GetAvailableTransitions")
    )
    labels = [entry["transition"]["label"] for entry in available["available_transitions"]]
    return LifecycleState(node, current["current_state"]["label"], sorted(set(labels)))


async def _call(robot: Robot, node: str, kind: str) -> dict[str, Any]:
    kind = f"lifecycle_msgs/srv/{kind}"
    return await _told(robot, node, ask_node(robot, node, kind, {}, timeout_s=TIMEOUT_S, wait_s=_APPEAR_S), TIMEOUT_S)


async def _done(robot: Robot, command: ChangeState) -> dict[str, Any]:
    return robot.fields_of(await robot.do(command))


async def _told(robot: Robot, node: str, asking: Awaitable[dict[str, Any]], timeout_s: float) -> dict[str, Any]:
    """The response; what went wrong is told of the node."""
    try:
        return await asking
    except NotFound as error:
        known = await _lifecycle_nodes(robot)
        hint = names.did_you_mean(node, known, f"Lifecycle nodes: {', '.join(known) or 'none'}.")
        raise NotFound(f"{node} is not a lifecycle node that is running.", hint) from error
    except TimedOut as error:
        raise TimedOut(f"{node} did not answer within {timeout_s:g} s: it is busy or hangs.") from error
