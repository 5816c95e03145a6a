"""Show one node in detail, as `ros2 node info` does."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass, field
from time import monotonic
from typing import Any

from ros2_mcp.model import names
from ros2_mcp.model.errors import NotFound, RobotError
from ros2_mcp.model.graph import NamedTypes, NodeEndpoints
from ros2_mcp.model.text import counted, named
from ros2_mcp.ops.nodes.list import list_nodes
from ros2_mcp.ops.nodes.own_services import ask_node, service_of
from ros2_mcp.ops.results.results import SAID
from ros2_mcp.robot import Robot
from ros2_mcp_common.policy.verbs import CHANGE_STATE

ANSWER_S = 0.4
"""Time for a node's own answers. They take milliseconds if the node spins: the facts from the graph must not wait for a
node that hangs.
"""
_DISCOVERED_S = 2.0
"""How long a node without known endpoints is looked up again: they are discovered within a second of the node."""
_POLL_S = 0.1
"""Seconds between two such requests: each is a round trip to the bridge and costs less than a millisecond."""
_PARAMETER_SERVICES = (
    "describe_parameters",
    "get_parameter_types",
    "get_parameters",
    "list_parameters",
    "set_parameters",
    "set_parameters_atomically",
)
_SEND_GOAL = "/_action/send_goal"


@dataclass(frozen=True, slots=True)
class Offer:
    """A topic, service or action of a node, with its type."""

    name: str
    type: str


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeInfo:
    """What one node publishes, subscribes to, serves and calls. `omitted` counts its services that are not shown: those
    that every node has for its parameters, and hidden ones, such as the services of its actions.

    `from_this_server`: the node belongs to this server. `parameters` is the number of its parameters, `lifecycle_state`
    its lifecycle state; each is null if the node has none or did not answer in time. `settled` is false if discovery
    was still under way, or has not reported the node's endpoints.
    """

    node: str = field(metadata=SAID)
    publishes: Sequence[Offer]
    subscribes: Sequence[Offer]
    services: Sequence[Offer]
    service_clients: Sequence[Offer]
    actions: Sequence[Offer]
    action_clients: Sequence[Offer]
    has_parameters: bool
    is_lifecycle: bool
    parameters: int | None = field(metadata=SAID)
    lifecycle_state: str | None = field(metadata=SAID)
    from_this_server: bool = field(default=False, metadata=SAID)
    omitted: int = field(default=0, metadata=SAID)
    settled: bool = field(default=True, metadata=SAID)

    def summary(self) -> str:
        """Return the result in one line."""
        has = "" if self.parameters is None else f" It has {self.parameters} parameters."
        state = f" Its lifecycle state is {named(self.lifecycle_state)}." if self.lifecycle_state else ""
        services = counted(self.omitted, "service")
        hidden = f" Not shown: {services} for its parameters and actions; ros2_service_list lists them."
        unsettled = " Discovery had not settled: the lists may be incomplete. Ask again."
        who = f"{self.node} (this server)" if self.from_this_server else self.node
        return (
            f"{who} publishes {len(self.publishes)} and subscribes to {len(self.subscribes)} topics, "
            f"offers {counted(len(self.services), 'service')} and {counted(len(self.actions), 'action')}.{has}{state}"
            f"{hidden if self.omitted else ''}{'' if self.settled else unsettled}"
        )


async def node_info(robot: Robot, node: str) -> NodeInfo:
    """Return what a node publishes, subscribes to, serves and calls.

    Raises:
        NotFound: if there is no such node in the graph.
    """
    node = names.absolute(node, "node")
    try:
        found, settled = await _discovered(robot, node)
    except NotFound as error:
        known = await list_nodes(robot, include_hidden=True)
        hint = await robot.graph.near(node, known.nodes, "ros2_node_list")
        raise NotFound(f"There is no node {node}.", hint) from error
    served = {entry.name for entry in found.servers}

    async def response(kind: str) -> dict[str, Any] | None:
        """Return the fields of the answer; None if the node has no such service, or does not answer at once."""
        if service_of(node, kind) not in served:
            return None
        try:
            return await robot.fields_of(await ask_node(robot, node, kind, {}, timeout_s=ANSWER_S))
        except RobotError:
            return None

    listed, current = await asyncio.gather(
        response("rcl_interfaces/srv/ListParameters"), response("lifecycle_msgs/srv/GetState")
    )
    own_parameters = {f"{node}/{service}" for service in _PARAMETER_SERVICES}
    all_of_it = _all_of(found)
    return NodeInfo(
        node=node,
        publishes=_offers(found.publishers),
        subscribes=_offers(found.subscribers),
        services=[offer for offer in _offers(found.servers) if offer.name not in own_parameters],
        service_clients=_offers(found.clients),
        actions=_actions(found.servers),
        action_clients=_actions(found.clients),
        from_this_server=node in robot.graph.own_nodes,
        settled=settled,
        omitted=len(own_parameters & served) + sum(names.is_hidden(row.name) for row in all_of_it),
        has_parameters=own_parameters <= served,
        is_lifecycle=service_of(node, CHANGE_STATE) in served,
        parameters=None if listed is None else len(listed["result"]["names"]),
        lifecycle_state=None if current is None else current["current_state"]["label"],
    )


async def _discovered(robot: Robot, node: str) -> tuple[NodeEndpoints, bool]:
    """Return the endpoints of a node, and whether discovery has settled. A node is discovered before its endpoints."""
    found, nodes = await asyncio.gather(robot.graph.node(node), robot.graph.nodes())
    deadline = monotonic() + _DISCOVERED_S
    while not _all_of(found) and monotonic() < deadline:
        await asyncio.sleep(_POLL_S)
        found = await robot.graph.node(node)
    return found, nodes.settled and bool(_all_of(found))


def _all_of(found: NodeEndpoints) -> Sequence[NamedTypes]:
    return (*found.publishers, *found.subscribers, *found.servers, *found.clients)


def _offers(rows: Sequence[NamedTypes]) -> list[Offer]:
    return [Offer(row.name, " | ".join(row.types)) for row in sorted(rows) if not names.is_hidden(row.name)]


def _actions(services: Sequence[NamedTypes]) -> list[Offer]:
    """Return the actions among these services. In the graph an action appears as its services; its hidden `send_goal`
    service gives the action's name and type.
    """
    return [
        Offer(row.name.removesuffix(_SEND_GOAL), " | ".join(row.types).removesuffix("_SendGoal"))
        for row in sorted(services)
        if row.name.endswith(_SEND_GOAL)
    ]
