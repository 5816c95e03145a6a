"""Lifecycle nodes: read their states and possible transitions, and make a transition, as `ros2 lifecycle` does."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

from ros2_mcp.model import names
from ros2_mcp.model.commands import ChangeState
from ros2_mcp.model.errors import BadInput, NotFound
from ros2_mcp.model.text import named
from ros2_mcp.ops.log.complaints import complaints_from_now
from ros2_mcp.ops.nodes.own_services import APPEAR_S, TIMEOUT_S, ask_node, fields_of_answer, service_of
from ros2_mcp.ops.nodes.stacks import stack_of, stacks_of
from ros2_mcp.ops.results.results import SAID, or_error
from ros2_mcp.robot import Robot
from ros2_mcp.robot.session import Session
from ros2_mcp_common.policy.verbs import CHANGE_STATE

CHANGE_S = 30.0
"""Time for a transition, which may start hardware: drivers take seconds to configure."""
_UNANSWERED = "The transition may still take effect: ros2_lifecycle_state shows where it has led."


@dataclass(frozen=True, slots=True)
class LifecycleState:
    """The state of one lifecycle node and the transitions that are possible now, by name.

    `managed_by` is the node that starts and stops it together with others, such as Nav2's lifecycle manager.
    """

    node: str
    state: str
    transitions: Sequence[str]
    error: str = ""
    managed_by: str = ""

    def summary(self) -> str:
        """Return the result in one line."""
        by = f" Managed by {named(self.managed_by)}." if self.managed_by else ""
        told = self.error or f"{named(self.state)}; possible now: {_listed(self.transitions)}."
        return f"{self.node}: {told}{by}"


@dataclass(frozen=True, slots=True)
class LifecycleStates:
    """The states of several lifecycle nodes."""

    nodes: Sequence[LifecycleState]
    note: str = field(default="", metadata=SAID)

    def summary(self) -> list[str]:
        """Return a line for each node."""
        return [node.summary() for node in self.nodes] or [f"No lifecycle node is running. {self.note}".rstrip()]


@dataclass(frozen=True, slots=True, kw_only=True)
class Transition:
    """The result of a transition: the states before and after, and the transitions that are possible now. If it failed,
    `note` has the warnings and errors that the robot logged meanwhile.
    """

    node: str = field(metadata=SAID)
    transition: str = field(metadata=SAID)
    successful: bool = field(metadata=SAID)
    state_before: str = field(metadata=SAID)
    state: str = field(metadata=SAID)
    transitions: Sequence[str]
    note: str = ""

    def summary(self) -> str:
        """Return the result in one line."""
        outcome = "done" if self.successful else "failed"
        states = f"{named(self.state_before)} → {named(self.state)}"
        return f"{self.node}: {named(self.transition)} {outcome}; {states}. {self.note}".rstrip()


async def states(robot: Robot, nodes: Sequence[str] = ()) -> LifecycleStates:
    """Return the states of the named nodes, or of every lifecycle node; the `error` of one node does not stop the
    others.
    """
    chosen = [names.absolute(node, "node") for node in nodes] or await _lifecycle_nodes(robot)
    asking = [or_error(_state(robot, node), partial(LifecycleState, node, "unknown", ())) for node in chosen]
    stacks, found = await asyncio.gather(stacks_of(robot), asyncio.gather(*asking))
    hosts = {node: stack.host for stack in stacks for node in stack.nodes}
    found = [replace(one, managed_by=hosts.get(one.node, "")) for one in found]
    return LifecycleStates(found, "" if found else await robot.graph.absence())


async def change(robot: Robot, session: Session, node: str, transition: str) -> Transition:
    """Make a transition that is possible now, such as `configure` or `activate`.

    Raises:
        NotFound: if the node does not exist or has no lifecycle.
        BadInput: if the transition is not possible now; it names those that are.
    """
    node = names.absolute(node, "node")
    before = await _state(robot, node)
    if transition not in before.transitions:
        problem = f"{node} is {named(before.state)}, where the transition {transition!r} is not possible."
        raise BadInput(problem, f"Possible now: {_listed(before.transitions)}.")
    available = (await _response(robot, node, "GetAvailableTransitions"))["available_transitions"]
    labelled = [entry["transition"] for entry in available if entry["transition"]["label"] == transition]
    # If it has become impossible in between, the node itself refuses: it checks the label before the id.
    chosen = labelled[0] if labelled else {"id": 0, "label": transition}
    command = ChangeState(
        principal=session.principal,
        name=node,
        through=service_of(node, CHANGE_STATE),
        type=CHANGE_STATE,
        value={"transition": chosen},
        transition=transition,
        transition_id=int(chosen["id"]),
        timeout_s=CHANGE_S,
        wait_s=APPEAR_S,
    )
    complaints, stack = complaints_from_now(robot), await stack_of(robot, node)
    response = await fields_of_answer(robot, node, robot.do(command, session), _not_found, CHANGE_S, _UNANSWERED)
    after = await _state(robot, node)
    return Transition(
        node=node,
        transition=transition,
        successful=response["success"],
        state_before=before.state,
        state=after.state,
        transitions=after.transitions,
        note=" ".join(
            filter(None, ("" if response["success"] else await complaints.said(node), stack.of(node) if stack else ""))
        ),
    )


def _listed(transitions: Sequence[str]) -> str:
    return ", ".join(map(named, transitions)) or "nothing"


async def _lifecycle_nodes(robot: Robot) -> list[str]:
    services = [row.name for row in await robot.graph.services() if CHANGE_STATE in row.types]
    ending = service_of("", CHANGE_STATE)
    return sorted(name.removesuffix(ending) for name in services if name.endswith(ending))


async def _state(robot: Robot, node: str) -> LifecycleState:
    current, available = await asyncio.gather(
        _response(robot, node, "GetState"), _response(robot, node, "GetAvailableTransitions")
    )
    labels = {entry["transition"]["label"] for entry in available["available_transitions"]}
    return LifecycleState(node, current["current_state"]["label"], sorted(labels))


async def _response(robot: Robot, node: str, kind: str) -> dict[str, Any]:
    asking = ask_node(robot, node, f"lifecycle_msgs/srv/{kind}", {}, timeout_s=TIMEOUT_S, wait_s=APPEAR_S)
    return await fields_of_answer(robot, node, asking, _not_found)


async def _not_found(robot: Robot, node: str) -> NotFound:
    known = await _lifecycle_nodes(robot)
    hint = names.did_you_mean(node, known, f"Lifecycle nodes: {', '.join(known) or 'none'}.")
    return NotFound(f"{node} is not a running lifecycle node.", hint)
