"""Parameters of nodes, through the services that every node has."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ros2_mcp.model import names, parameters
from ros2_mcp.model.commands import SetParameters
from ros2_mcp.model.errors import BadInput, BadValue, NotFound, RobotError, TimedOut
from ros2_mcp.ops.nodes.list import ask_node, list_nodes
from ros2_mcp.robot import Robot
from ros2_mcp.robot.translation import SET_PARAMETERS, SET_PARAMETERS_ATOMICALLY

TIMEOUT_S = 5.0
"""A node that spins answers within milliseconds, and one that is starting up within seconds."""
_DISCOVERY_S = 6.0
"""How old a bridge is that has discovered the services of every node: they come up to 3 s after the nodes."""
_APPEAR_S = 1.0
"""For a service of a node that has only just come up, where the bridge knows the others."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter with what its descriptor says; `range` is null where any value is allowed."""

    name: str
    type: str
    value: Any
    description: str = ""
    read_only: bool = False
    range: dict[str, Any] | None = None
    constraints: str = ""


@dataclass(frozen=True, slots=True)
class NodeParameters:
    """The parameters of one node, or the `error` why they could not be read."""

    node: str
    parameters: Sequence[Parameter] = ()
    error: str = ""


@dataclass(frozen=True, slots=True)
class ParameterList:
    """The parameters of several nodes."""

    nodes: Sequence[NodeParameters]
    note: str

    def summary(self) -> str:
        """A line for each node."""
        lines = [f"{n.node}: {n.error or f'{len(n.parameters)} parameter(s)'}" for n in self.nodes]
        return "\n".join([*lines, self.note]).rstrip()


@dataclass(frozen=True, slots=True)
class Dump:
    """All parameters of a node as name → value, in the form that setting takes."""

    node: str
    parameters: dict[str, Any]
    read_only: Sequence[str]

    def summary(self) -> str:
        """One line."""
        return f"{self.node}: {len(self.parameters)} parameter(s), {len(self.read_only)} of them read-only."


@dataclass(frozen=True, slots=True)
class SetOne:
    """Whether the node took one value, and what it said if not; `value` is read back afterwards."""

    name: str
    successful: bool
    reason: str
    value: Any


@dataclass(frozen=True, slots=True)
class SetResult:
    """What the node made of each value. With `atomic` all were taken or none."""

    node: str
    successful: bool
    atomic: bool
    parameters: Sequence[SetOne]

    def summary(self) -> str:
        """One line, and one for each refusal."""
        taken = sum(one.successful for one in self.parameters)
        refused = [
            f"{one.name}: {one.reason or 'refused without a reason'}" for one in self.parameters if not one.successful
        ]
        return "\n".join([f"{self.node}: {taken} of {len(self.parameters)} parameter(s) set.", *refused])


async def describe(robot: Robot, nodes: Sequence[str], pattern: str = "", limit: int = 200) -> ParameterList:
    """Parameters with values and descriptors, of several nodes at once; an `error` of one leaves the others.

    Without nodes: of every node.
    """
    wanted = [names.absolute(node, "node") for node in nodes] or list((await list_nodes(robot)).nodes)
    found = await asyncio.gather(*(_describe_or_error(robot, node, pattern) for node in wanted))
    total = sum(len(node.parameters) for node in found)
    shown: list[NodeParameters] = []
    left = limit
    for node in found:
        if pattern and not (nodes or node.parameters or node.error):
            continue
        shown.append(NodeParameters(node.node, node.parameters[:left], node.error))
        left = max(left - len(node.parameters), 0)
    note = f"{total} parameters match, the first {limit} are shown." if total > limit else ""
    return ParameterList(shown, note)


async def dump(robot: Robot, node: str, wanted: Sequence[str] | None = None) -> Dump:
    """Parameters of a node, the wanted ones or all, in a form that can be set back.

    Raises:
        NotFound: if the node is not there, or a parameter is not declared.
    """
    node = names.absolute(node, "node")
    known = await _names(robot, node)
    for name in wanted or ():
        if name not in known:
            hint = names.did_you_mean(name, known, f"It has: {', '.join(known[:20])}.")
            raise NotFound(f"{node} has no parameter {name}.", hint)
    found = await _read(robot, node, list(known if wanted is None else wanted))
    values = {parameter.name: parameter.value for parameter in found if parameter.type != "not_set"}
    return Dump(node, values, [parameter.name for parameter in found if parameter.read_only])


async def set_values(robot: Robot, node: str, values: Mapping[str, Any], *, atomic: bool = False) -> SetResult:
    """Sets parameters, after each value has been converted to the declared type; reads them back.

    A read-only parameter may be among them with the value that it has, as in what was read.

    Raises:
        NotFound: if the node is not there.
        BadValue: if a value is not of its parameter's type or out of its range, or the parameter is read-only or not
            declared; nothing is set.
    """
    node = names.absolute(node, "node")
    if not values:
        raise BadInput("No parameters are given.", 'Give an object such as {"max_speed": 0.5}.')
    try:
        messages = await _messages(robot, node, values)
    except BadValue as error:
        raise BadValue("", error.message, f"{error.hint} Nothing was set.".lstrip()) from error
    command = SetParameters(
        principal=robot.principal,
        name=node,
        through=f"{node}/set_parameters{'_atomically' if atomic else ''}",
        type=SET_PARAMETERS_ATOMICALLY if atomic else SET_PARAMETERS,
        value={"parameters": messages},
        parameters={message["name"]: parameters.value_of(message["value"]) for message in messages},
        timeout_s=TIMEOUT_S,
        wait_s=await _time_to_appear(robot),
    )
    response = await _told(robot, node, _done(robot, command))
    results = [response["result"]] * len(messages) if atomic else response["results"]
    result_of = {message["name"]: result for message, result in zip(messages, results, strict=True)}
    now = {parameter.name: parameter.value for parameter in await _read(robot, node, list(values))}
    kept = {"successful": True, "reason": "it is read-only and has this value"}
    ones = [
        SetOne(name, result["successful"], result["reason"], now.get(name))
        for name, result in ((name, result_of.get(name, kept)) for name in values)
    ]
    return SetResult(node, all(one.successful for one in ones), atomic, ones)


async def _messages(robot: Robot, node: str, values: Mapping[str, Any]) -> list[dict[str, Any]]:
    known = await _names(robot, node)
    declared = {p.name: p for p in await _read(robot, node, [name for name in values if name in known])}
    for name in values:
        if name not in declared and not await _allows_undeclared(robot, node, name):
            hint = names.did_you_mean(name, known, f"It has: {', '.join(known[:20])}.")
            raise BadValue(name, f"{node} has no such parameter.", hint)
    return [
        {"name": name, "value": _checked(name, value, declared.get(name))}
        for name, value in values.items()
        if not _is_kept(value, declared.get(name))
    ]


def _is_kept(value: Any, parameter: Parameter | None) -> bool:
    """Whether a read-only parameter is given the value that it has."""
    return parameter is not None and parameter.read_only and bool(value == parameter.value)


def _checked(name: str, value: Any, parameter: Parameter | None) -> dict[str, Any]:
    if parameter is None:
        return parameters.as_message(name, value, "dynamic")
    if parameter.read_only:
        raise BadValue(name, "it is read-only.", "It can be set only when the node starts.")
    message = parameters.as_message(name, value, parameter.type)
    _check_range(name, parameters.value_of(message), parameter.range)
    return message


def _check_range(name: str, value: Any, allowed: Mapping[str, Any] | None) -> None:
    if allowed is None or not isinstance(value, (int, float)) or isinstance(value, bool):
        return
    if not float(allowed["from"]) <= value <= float(allowed["to"]):
        raise BadValue(name, f"{value} is out of range.", f"It takes {allowed['from']} to {allowed['to']}.")


async def _allows_undeclared(robot: Robot, node: str, name: str) -> bool:
    """Whether a node answers a question for an undeclared parameter, which only nodes that allow them do."""
    response = await _call(robot, node, "GetParameters", {"names": [name]})
    return len(response["values"]) == 1


async def _describe_or_error(robot: Robot, node: str, pattern: str) -> NodeParameters:
    try:
        chosen = names.matching(await _names(robot, node), pattern)
        return NodeParameters(node, await _read(robot, node, chosen))
    except RobotError as error:
        return NodeParameters(node, error=str(error))


async def _names(robot: Robot, node: str) -> list[str]:
    response = await _call(robot, node, "ListParameters", {"prefixes": [], "depth": 0})
    return sorted(response["result"]["names"])


async def _read(robot: Robot, node: str, wanted: list[str]) -> list[Parameter]:
    if not wanted:
        return []
    values, descriptors = await asyncio.gather(
        _call(robot, node, "GetParameters", {"names": wanted}),
        _call(robot, node, "DescribeParameters", {"names": wanted}),
    )
    return [
        _parameter(name, value, descriptor)
        for name, value, descriptor in zip(wanted, values["values"], descriptors["descriptors"], strict=False)
    ]


def _parameter(name: str, value: Mapping[str, Any], descriptor: Mapping[str, Any]) -> Parameter:
    code = int(value["type"])
    declared = parameters.type_name(code or int(descriptor["type"]))
    return Parameter(
        name,
        "dynamic" if descriptor["dynamic_typing"] else declared,
        parameters.value_of(value),
        descriptor["description"],
        descriptor["read_only"],
        _range(descriptor),
        descriptor["additional_constraints"],
    )


def _range(descriptor: Mapping[str, Any]) -> dict[str, Any] | None:
    for kind in ("floating_point_range", "integer_range"):
        for allowed in descriptor[kind]:
            return {"from": allowed["from_value"], "to": allowed["to_value"], "step": allowed["step"]}
    return None


async def _done(robot: Robot, command: SetParameters) -> dict[str, Any]:
    return robot.fields_of(await robot.do(command))


async def _time_to_appear(robot: Robot) -> float:
    """How long a service may take to be seen: the younger the bridge, the longer. Services come after their nodes."""
    return max(_APPEAR_S, _DISCOVERY_S - (await robot.graph.bridge_status()).uptime_s)


async def _call(robot: Robot, node: str, kind: str, request: Mapping[str, Any]) -> dict[str, Any]:
    """One of a node's reading parameter services; the response in full."""
    kind, wait_s = f"rcl_interfaces/srv/{kind}", await _time_to_appear(robot)
    return await _told(robot, node, ask_node(robot, node, kind, request, timeout_s=TIMEOUT_S, wait_s=wait_s))


async def _told(robot: Robot, node: str, asking: Awaitable[dict[str, Any]]) -> dict[str, Any]:
    """The response; what went wrong is told of the node."""
    try:
        return await asking
    except NotFound as error:
        known = (await list_nodes(robot, include_hidden=True)).nodes
        if node in known:
            hint = "It was started without them, or has only just come up: then try again."
            raise NotFound(f"{node} shows no parameter services.", hint) from error
        raise NotFound(f"There is no node {node}.", names.did_you_mean(node, known)) from error
    except TimedOut as error:
        raise TimedOut(f"{node} did not answer within {TIMEOUT_S:g} s: it is busy or hangs.") from error
