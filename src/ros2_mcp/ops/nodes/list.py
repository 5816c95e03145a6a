"""Nodes: which there are, and what each offers and uses."""

from __future__ import annotations

import asyncio
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ros2_mcp.model import names
from ros2_mcp.model.errors import NotFound, RobotError
from ros2_mcp.model.graph import NamedTypes, NodeEndpoints
from ros2_mcp.robot import Robot

ANSWER_S = 0.4
"""A node that spins answers within milliseconds; what else is told of it must not wait for one that does not."""
_PARAMETER_SERVICES = (
    "describe_parameters",
    "get_parameter_types",
    "get_parameters",
    "list_parameters",
    "set_parameters",
    "set_parameters_atomically",
)


@dataclass(frozen=True, slots=True)
class NodeList:
    """The nodes of the graph by full name; `duplicates` are names that several nodes share, which is a fault."""

    nodes: Sequence[str]
    total: int
    settled: bool
    duplicates: Sequence[str]
    note: str

    def summary(self) -> str:
        """One line."""
        return f"{len(self.nodes)} of {self.total} nodes. {self.note}".rstrip()


@dataclass(frozen=True, slots=True)
class Offer:
    """A topic, service or action of a node, with its type."""

    name: str
    type: str


@dataclass(frozen=True, slots=True)
class NodeInfo:
    """What one node offers and uses; the six parameter services that every node has are left out.

    `parameters` is how many it has and `lifecycle_state` its state, null where it has none or did not answer at once.
    """

    node: str
    publishes: Sequence[Offer]
    subscribes: Sequence[Offer]
    services: Sequence[Offer]
    service_clients: Sequence[Offer]
    actions: Sequence[Offer]
    action_clients: Sequence[Offer]
    has_parameters: bool
    is_lifecycle: bool
    parameters: int | None
    lifecycle_state: str | None

    def summary(self) -> str:
        """One line."""
        has = "" if self.parameters is None else f" It has {self.parameters} parameters."
        state = f" Its lifecycle state is {self.lifecycle_state}." if self.lifecycle_state else ""
        return (
            f"{self.node} publishes {len(self.publishes)} and subscribes to {len(self.subscribes)} topics, "
            f"offers {len(self.services)} services and {len(self.actions)} actions.{has}{state}"
        )


async def list_nodes(robot: Robot, pattern: str = "", include_hidden: bool = False, limit: int = 200) -> NodeList:
    """The nodes whose full names match the pattern, sorted; our own bridge is left out."""
    found = await robot.graph.nodes()
    others = [row.name for row in found if row.name not in robot.graph.own_nodes]
    visible = sorted(name for name in others if include_hidden or not names.is_hidden(name))
    chosen = names.matching(visible, pattern)
    duplicates = [name for name, count in Counter(visible).items() if count > 1]
    notes = [f"{len(chosen)} match, the first {limit} are shown."] if len(chosen) > limit else []
    notes += ["Discovery had not settled yet: ask again."] if not found.settled else []
    return NodeList(chosen[:limit], len(visible), found.settled, duplicates, " ".join(notes))


async def node_info(robot: Robot, node: str) -> NodeInfo:
    """What a node publishes, subscribes to, serves and calls.

    Raises:
        NotFound: if no such node is in the graph.
    """
    full = names.absolute(node, "node")
    try:
        found = await robot.graph.node(full)
    except NotFound as error:
        known = await list_nodes(robot, include_hidden=True)
        hint = names.did_you_mean(full, known.nodes, "ros2_node_list shows what is there.")
        raise NotFound(f"There is no node {full}.", hint) from error
    served = {entry.name for entry in found.servers}
    listed, current = await asyncio.gather(
        _at_once(robot, full, "rcl_interfaces/srv/ListParameters", served),
        _at_once(robot, full, "lifecycle_msgs/srv/GetState", served),
    )
    parameters = None if listed is None else len(listed["result"]["names"])
    return _assemble(full, found, parameters, None if current is None else current["current_state"]["label"])


async def ask_node(
    robot: Robot, node: str, kind: str, request: Mapping[str, Any], *, timeout_s: float, wait_s: float | None = None
) -> dict[str, Any]:
    """The response, in full, of the service of a node whose name follows from its type: `GetState` is `get_state`.

    Raises as `Robot.ask_service`.
    """
    answer = await robot.ask_service(_service_of(node, kind), kind, request, timeout_s=timeout_s, wait_s=wait_s)
    return robot.fields_of(answer)


def _service_of(node: str, kind: str) -> str:
    return f"{node}/{re.sub(r'(?<=[a-z])(?=[A-Z])', '_', kind.rpartition('/')[2]).lower()}"


async def _at_once(robot: Robot, node: str, kind: str, served: set[str]) -> dict[str, Any] | None:
    """The same; None where the node has no such service, or does not answer at once."""
    if _service_of(node, kind) not in served:
        return None
    try:
        return await ask_node(robot, node, kind, {}, timeout_s=ANSWER_S)
    except RobotError:
        return None


def _assemble(node: str, found: NodeEndpoints, parameters: int | None, lifecycle_state: str | None) -> NodeInfo:
    servers = _offers(found.servers)
    own_parameters = {f"{node}/{service}" for service in _PARAMETER_SERVICES}
    served = {offer.name for offer in servers}
    return NodeInfo(
        node,
        publishes=_visible(_offers(found.publishers)),
        subscribes=_visible(_offers(found.subscribers)),
        services=[offer for offer in _visible(servers) if offer.name not in own_parameters],
        service_clients=_visible(_offers(found.clients)),
        actions=_actions(servers),
        action_clients=_actions(_offers(found.clients)),
        has_parameters=own_parameters <= served,
        is_lifecycle=f"{node}/change_state" in served,
        parameters=parameters,
        lifecycle_state=lifecycle_state,
    )


def _offers(rows: Sequence[NamedTypes]) -> list[Offer]:
    return [Offer(row.name, " | ".join(row.types)) for row in sorted(rows)]


def _visible(offers: Sequence[Offer]) -> list[Offer]:
    return [offer for offer in offers if not names.is_hidden(offer.name)]


def _actions(services: Sequence[Offer]) -> list[Offer]:
    ending = "/_action/send_goal"
    return [
        Offer(offer.name[: -len(ending)], offer.type.removesuffix("_SendGoal"))
        for offer in services
        if offer.name.endswith(ending)
    ]
