"""List, read and set parameters of nodes, as `ros2 param` does, through the services that every node has."""

from __future__ import annotations

import asyncio
import json
import re
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, cast

from ros2_mcp.model import names, parameters
from ros2_mcp.model.commands import SetParameters
from ros2_mcp.model.errors import BadInput, BadValue, NotFound
from ros2_mcp.model.text import counted, in_quotes, listed, named, quoted
from ros2_mcp.ops.nodes.list import list_nodes
from ros2_mcp.ops.nodes.own_services import APPEAR_S, TIMEOUT_S, ask_node, by_name, fields_of_answer, service_of
from ros2_mcp.ops.results.results import EXACT, HIDDEN, IF_ANY, ON_REQUEST, SAID, answer_bytes, list_note, or_error
from ros2_mcp.robot import Robot
from ros2_mcp.robot.session import Session
from ros2_mcp_common.policy.verbs import SET_PARAMETERS, SET_PARAMETERS_ATOMICALLY

_DISCOVERY_S = 6.0
"""The age at which a bridge has discovered the services of every node: they come up to 3 s after the nodes."""
_SHORT_BYTES = 1000
"""As JSON. A value up to this size is always shown: there are hundreds of them at most. Of longer
values, as many are shown as fit."""
_MAX_NAMED = 5
"""Parameters that are named in the one line of a summary."""
_LONG_HINT = (
    "omitted gives the length; ros2_parameter_get with its name and whole=true returns it if it fits in an answer, "
    "or a part of it,"
)
_WHOLE_HINT = "Call again with that parameter's name and whole=true, or a part of it,"
_PARTS_HINT = "No answer has room for it, with whole=true neither: ask for its parts,"
_PART_OF = re.compile(r"(?P<name>.+)\[(?P<start>\d*):(?P<end>\d*)\]")
"""A part of a long text or list, as in a path to a field."""
_PART_LENGTH = 8000
"""Characters of a part that fit into one answer, with their quotes escaped."""
_OF_EVERY_NODE: Mapping[str, Any] = {"use_sim_time": False, "start_type_description_service": True}
"""The parameters that rclcpp and rclpy declare for each node, with their defaults."""
_OVERRIDES = "qos_overrides."
"""The prefix of four to seven parameters for each topic whose QoS can be changed at the start. Only the node knows
which of them are at their defaults."""
_MAX_TEXT = 500
"""The most characters of a description, of constraints, or of a node's reason."""
_NO_DESCRIPTOR: Mapping[str, Any] = {
    "type": 0,
    "dynamic_typing": False,
    "description": "",
    "read_only": False,
    "floating_point_range": (),
    "integer_range": (),
    "additional_constraints": "",
}
"""Of a parameter that its node does not describe."""
_NO_RESULT: Mapping[str, Any] = {"successful": False, "reason": "the node's answer has no result for it"}
_UNANSWERED = "The change may still take effect: read it with ros2_parameter_get before you set it again."


@dataclass(frozen=True, slots=True, kw_only=True)
class Parameter:
    """One parameter and its descriptor; `range` is null if any value is allowed.

    `omitted` gives the length of a value that is too long to show (the value is then null). `not_set`: the parameter is
    declared but has no value yet (the value is then null).
    """

    name: str
    type: str
    value: Any = field(metadata=EXACT)
    description: str = ""
    read_only: bool = False
    range: dict[str, Any] | None = None
    constraints: str = ""
    omitted: str = ""
    not_set: bool | None = field(default=None, metadata=ON_REQUEST)


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
    note: str = field(metadata=IF_ANY)

    def summary(self) -> list[str]:
        """Return a line for each node."""
        lines = [f"{n.node}: {n.error or counted(len(n.parameters), 'parameter')}" for n in self.nodes]
        return [*lines, self.note] if self.note else lines


@dataclass(frozen=True, slots=True)
class Dump:
    """All parameters of a node as name → value, in the form that ros2_parameter_set takes.

    `omitted` gives the lengths of values that are too long to show: setting the others back does not change these.
    `unset_types` has the declared types of parameters without a value, `empty_list_types` those of empty lists. `parts`
    has parts of long values that were requested, such as `robot_description[0:8000]`. `fits_whole`: an answer has room
    for each omitted value.
    """

    node: str = field(metadata=SAID)
    parameters: dict[str, Any]
    read_only: Sequence[str]
    omitted: dict[str, str] = field(metadata=IF_ANY)
    note: str = ""
    unset_types: dict[str, str] = field(default_factory=dict[str, str])
    empty_list_types: dict[str, str] = field(default_factory=dict[str, str])
    parts: dict[str, Any] = field(default_factory=dict[str, Any], metadata=IF_ANY)
    fits_whole: bool = field(default=True, metadata=HIDDEN)

    def summary(self) -> str:
        """Return the result in one line."""
        count = counted(len(self.parameters), "parameter")
        declared = f" {len(self.unset_types)} declared without a value." if self.unset_types else ""
        line = f"{self.node}: {count}, {len(self.read_only)} read-only.{declared} {self.note}".rstrip()
        if not self.omitted:
            return line
        long = ", ".join(f"{named(name)} ({size})" for name, size in list(self.omitted.items())[:_MAX_NAMED])
        return (
            f"{line} Too long to show: {long}. {_WHOLE_HINT if self.fits_whole else _PARTS_HINT} "
            f"{_part_hint(next(iter(self.omitted)))}."
        )


@dataclass(frozen=True, slots=True)
class SetOne:
    """Whether the node accepted one value, and its reason if not; `value` is read back afterwards.

    `omitted` gives the length of a value that is too long to show (the value is then null). `before` is the previous
    value.
    """

    name: str
    successful: bool
    reason: str = field(metadata=IF_ANY)
    value: Any = field(metadata=EXACT)
    omitted: str = ""
    before: Any = field(default=None, metadata=HIDDEN)


@dataclass(frozen=True, slots=True)
class SetResult:
    """Whether the node accepted each value. With `atomic`, it accepted all or none."""

    node: str = field(metadata=SAID)
    successful: bool
    atomic: bool
    parameters: Sequence[SetOne]
    note: str = ""

    def summary(self) -> list[str]:
        """Return one line, and one line for each refusal."""
        taken = [one for one in self.parameters if one.successful]
        changes = [
            f"{named(one.name)} = {one.omitted or in_quotes(one.value)} (was {_before(one.before)})" for one in taken
        ]
        more = f" and {len(taken) - _MAX_NAMED} more" if len(taken) > _MAX_NAMED else ""
        now = f": {', '.join(changes[:_MAX_NAMED])}{more}" if changes else ""
        refused = [
            f"{named(one.name)}: refused {f'because {quoted(one.reason)}' if one.reason else 'without a reason'}"
            for one in self.parameters
            if not one.successful
        ]
        return [
            f"{self.node}: {len(taken)} of {counted(len(self.parameters), 'parameter')} set{now}. {self.note}".rstrip(),
            *refused,
        ]


def _part_hint(name: str) -> str:
    return f'such as names=["{named(name)}[0:{_PART_LENGTH}]"]'


def _before(value: Any) -> str:
    return "not set" if value is None else in_quotes(value)


class _Room:
    """The bytes of an answer that remain for long values of parameters. Values that do not fit are omitted."""

    def __init__(self, max_bytes: int) -> None:
        self._left = max_bytes

    def shown(self, parameter: Parameter) -> Parameter:
        """Return the parameter with its texts cut, and without its value if that does not fit."""
        size = _bytes_of(parameter)
        omitted = ""
        if size > _SHORT_BYTES:
            if size > self._left:
                omitted = _size_in_words(parameter.value)
            else:
                self._left -= size
        return replace(
            parameter,
            value=None if omitted else parameter.value,
            omitted=omitted,
            description=_cut(parameter.description),
            constraints=_cut(parameter.constraints),
        )


def _bytes_of(parameter: Parameter) -> int:
    return len(json.dumps(parameter.value, ensure_ascii=False).encode("utf-8", "surrogatepass"))


def _size_in_words(value: Any) -> str:
    if isinstance(value, list):
        return f"{len(cast('list[Any]', value))} elements"
    return f"{len(value)} characters"


def _cut(text: str) -> str:
    return text if len(text) <= _MAX_TEXT else f"{text[:_MAX_TEXT]}… ({len(text)} characters)"


async def describe(robot: Robot, nodes: Sequence[str], pattern: str = "", limit: int = 200) -> ParameterList:
    """Return the parameters of several nodes with values and descriptors; an `error` concerns one node only.

    Without nodes, those of every node. Without a pattern, parameters that every node has are omitted if they are at
    their defaults, and so are all `qos_overrides.`.
    """
    omitted = 0

    async def described(node: str) -> NodeParameters:
        nonlocal omitted
        declared = await _names(robot, node)
        found = await _read(robot, node, names.matching(declared, pattern), declared)
        meant = [one for one in found if pattern or not _is_usual(one)]
        omitted += len(found) - len(meant)
        return NodeParameters(node, meant)

    chosen = [names.absolute(node, "node") for node in nodes] or list((await list_nodes(robot)).nodes)
    found = await asyncio.gather(*(or_error(described(node), partial(NodeParameters, node)) for node in chosen))
    total = sum(len(node.parameters) for node in found)
    shown: list[NodeParameters] = []
    left, room = limit, _Room(answer_bytes(robot))
    for node in found:
        if pattern and not (nodes or node.parameters or node.error):
            continue  # this node was not named, and has no such parameter
        shown.append(NodeParameters(node.node, [room.shown(one) for one in node.parameters[:left]], node.error))
        left = max(left - len(node.parameters), 0)
    long = [one.name for node in shown for one in node.parameters if one.omitted]
    notes = [await shared_names(robot, [node.node for node in shown]), list_note(total, limit)]
    notes += [f"Too long to show: {counted(len(long), 'value')}; {_LONG_HINT} {_part_hint(long[0])}."] if long else []
    if omitted:
        usual = ", ".join((*(f"{name} at its default" for name in _OF_EVERY_NODE), f"{_OVERRIDES}*"))
        notes.append(f"Not shown: {omitted} standard parameters ({usual}); give a pattern to show them.")
    return ParameterList(shown, " ".join(filter(None, notes)))


async def all_of(robot: Robot, node: str) -> Sequence[Parameter]:
    """Return all parameters of one node, with values of any length. Raises the same errors as `dump`."""
    declared = await _names(robot, node)
    return await _read(robot, node, declared, declared)


def _is_usual(parameter: Parameter) -> bool:
    """Return whether a parameter is a standard parameter that says nothing about its node."""
    is_default = parameter.name in _OF_EVERY_NODE and parameter.value is _OF_EVERY_NODE[parameter.name]
    return is_default or parameter.name.startswith(_OVERRIDES)


async def dump(robot: Robot, node: str, asked: Sequence[str] | None = None, *, whole: bool = False) -> Dump:
    """Return parameters of a node, the requested parameters or all, in a form that can be set back; long values only if
    `whole`.

    Raises:
        NotFound: if the node does not exist, or a parameter is not declared.
    """
    node = names.absolute(node, "node")
    declared = await _names(robot, node)
    asked_parts = {name: part for name in asked or () if name not in declared and (part := _PART_OF.fullmatch(name))}
    wanted = [name for name in asked or () if name not in asked_parts]
    for name in (*wanted, *(part["name"] for part in asked_parts.values())):
        if name not in declared:
            raise NotFound(f"{node} has no parameter {name}.", _near(name, declared))
    found = await _read(robot, node, declared if asked is None else wanted, declared)
    longer = {part["name"]: None for part in asked_parts.values()}
    read_for_parts = {one.name: one.value for one in await _read(robot, node, list(longer), declared)}
    room = _Room(answer_bytes(robot))
    shown = found if whole else [room.shown(parameter) for parameter in found]
    notes = [await shared_names(robot, [node])]
    notes += [
        f"{named(one.name)} has {len(one.value)} characters: where it has no room here, ask for parts of it, "
        f"{_part_hint(one.name)}."
        for one in shown
        if isinstance(one.value, str) and len(one.value) > _PART_LENGTH
    ]
    values = {one.name: one.value for one in shown if not (one.not_set or one.omitted)}
    omitted = {one.name: one.omitted for one in shown if one.omitted}
    return Dump(
        node,
        values,
        [parameter.name for parameter in found if parameter.read_only],
        omitted,
        " ".join(filter(None, notes)),
        unset_types={one.name: one.type for one in found if one.not_set},
        empty_list_types={
            one.name: one.type for one in found if one.type.endswith("_array") and not (one.value or one.not_set)
        },
        parts={name: _part_of(name, part, read_for_parts[part["name"]]) for name, part in asked_parts.items()},
        fits_whole=all(_bytes_of(one) < answer_bytes(robot) for one in found if one.name in omitted),
    )


def _part_of(name: str, part: re.Match[str], value: Any) -> Any:
    if not isinstance(value, (str, list)):
        raise BadValue(name, "it is neither a string nor a list.", f"Ask for {named(part['name'])}.")
    start, end = (int(part[bound]) if part[bound] else None for bound in ("start", "end"))
    return cast("str | list[Any]", value)[start:end]


async def set_values(
    robot: Robot, session: Session, node: str, values: Mapping[str, Any], *, atomic: bool = False
) -> SetResult:
    """Set parameters, after converting each value to the declared type, and read them back.

    A read-only parameter with the value that it already has is no error: all that `dump` has read can be set back.

    Raises:
        NotFound: if the node does not exist.
        BadValue: if a value is not of its parameter's type or out of its range, or the parameter is read-only or not
            declared; nothing is set.
    """
    node = names.absolute(node, "node")
    if not values:
        raise BadInput("No parameters are given.", 'Give an object such as {"max_speed": 0.5}.')
    try:
        messages, before = await _messages(robot, node, values)
    except BadValue as error:
        raise BadValue("", error.message, f"{error.hint} Nothing was set.".lstrip()) from error
    kind = SET_PARAMETERS_ATOMICALLY if atomic else SET_PARAMETERS
    command = SetParameters(
        principal=session.principal,
        name=node,
        through=service_of(node, kind),
        type=kind,
        value={"parameters": messages},
        parameters={message["name"]: parameters.value_of(message["value"]) for message in messages},
        timeout_s=TIMEOUT_S,
        wait_s=await _time_to_appear(robot),
    )
    result_of = await _set(robot, session, command)
    room = _Room(answer_bytes(robot))
    now = {parameter.name: room.shown(parameter) for parameter in await _read(robot, node, list(values), ())}
    # The result for parameters left out of the request: a node would refuse a read-only one even with its own value.
    kept = {"successful": True, "reason": "it is read-only and has this value"}
    ones: list[SetOne] = []
    for name in values:
        result = result_of.get(name, kept)
        value, omitted = (now[name].value, now[name].omitted) if name in now else (None, "")
        was = before.get(name)
        ones.append(SetOne(name, result["successful"], _cut(result["reason"]), value, omitted, before=was))
    return SetResult(node, all(one.successful for one in ones), atomic, ones, await shared_names(robot, [node]))


async def _set(robot: Robot, session: Session, command: SetParameters) -> dict[str, Mapping[str, Any]]:
    """Set the parameters, and return the node's answer for each.

    A node that answers for fewer parameters than it was asked to set (micro-ROS with little memory takes one at a time,
    and answers nothing to a list) is asked again for each in turn.
    """
    messages = cast("Mapping[str, Any]", command.value)["parameters"]
    answering = robot.do(command, session)
    response = await fields_of_answer(robot, command.name, answering, _not_found, unanswered=_UNANSWERED)
    if command.type == SET_PARAMETERS_ATOMICALLY:
        return {message["name"]: response["result"] for message in messages}
    results = response["results"]
    if len(results) == len(messages):
        return {message["name"]: result for message, result in zip(messages, results, strict=True)}
    if len(messages) == 1:
        return {messages[0]["name"]: _NO_RESULT}
    found: dict[str, Mapping[str, Any]] = {}
    for message in messages:
        name, value = message["name"], {"parameters": [message]}
        one = replace(command, value=value, parameters={name: command.parameters[name]})
        found |= await _set(robot, session, one)
    return found


async def _messages(
    robot: Robot, node: str, values: Mapping[str, Any]
) -> tuple[list[dict[str, Any]], Mapping[str, Any]]:
    """Return the values as `rcl_interfaces/msg/Parameter`, checked, without read-only parameters that already have
    their value; and the present values.
    """
    declared = await _names(robot, node)
    known = [name for name in values if name in declared]
    current = {found.name: found for found in await _read(robot, node, known, declared)}
    messages: list[dict[str, Any]] = []
    for name, value in values.items():
        parameter = current.get(name)
        if parameter is None:
            # A node answers a request for an undeclared parameter only if it allows undeclared ones.
            answer = await _response(robot, node, "GetParameters", {"names": [name]})
            if len(answer["values"]) != 1:
                raise BadValue(name, f"{node} has no such parameter.", _near(name, declared))
            messages.append({"name": name, "value": parameters.as_message(name, value, "dynamic")})
        elif not parameter.read_only:
            message = parameters.as_message(name, value, parameter.type)
            _check_range(name, parameters.value_of(message), parameter.range)
            messages.append({"name": name, "value": message})
        elif value != parameter.value:
            raise BadValue(name, "it is read-only.", "Set it when you start the node.")
    return messages, {name: parameter.value for name, parameter in current.items()}


def _check_range(name: str, value: Any, allowed: Mapping[str, Any] | None) -> None:
    if allowed is None or not isinstance(value, (int, float)) or isinstance(value, bool):
        return
    if not float(allowed["from"]) <= value <= float(allowed["to"]):
        raise BadValue(name, f"{value} is out of range.", f"It takes {allowed['from']} to {allowed['to']}.")


async def shared_names(robot: Robot, nodes: Sequence[str]) -> str:
    """Return a sentence on the names that several nodes have; empty if there are none."""
    counts = Counter(row.name for row in await robot.graph.nodes())
    shared = [node for node in nodes if counts[node] > 1]
    most = max((counts[node] for node in shared), default=0)
    how_many = f"{most} nodes have" if len(shared) < 2 else "Several nodes each have"
    return f"{how_many} the name {listed(shared, _MAX_NAMED)}; it is unknown which one answered." if shared else ""


def _near(name: str, declared: Sequence[str]) -> str:
    return names.did_you_mean(name, declared, f"It has: {', '.join(map(named, declared[:20]))}.")


async def _names(robot: Robot, node: str) -> list[str]:
    response = await _response(robot, node, "ListParameters", {"prefixes": [], "depth": 0})
    return sorted(response["result"]["names"])


async def _read(robot: Robot, node: str, asked: Sequence[str], declared: Collection[str]) -> list[Parameter]:
    """Return the requested parameters that the node knows. Those in `declared` are returned even if the
    node reports nothing about them.
    """
    if not asked:
        return []
    values, descriptors = await asyncio.gather(
        _of_each(robot, node, "GetParameters", "values", asked),
        _of_each(robot, node, "DescribeParameters", "descriptors", asked),
    )
    known = [name for name in asked if name in values or name in descriptors or name in declared]
    untold = [name for name in known if name not in values and not descriptors.get(name, _NO_DESCRIPTOR)["type"]]
    types = await _of_each(robot, node, "GetParameterTypes", "types", untold)
    return [
        _parameter(name, values.get(name), descriptors.get(name, _NO_DESCRIPTOR), int(types.get(name, 0)))
        for name in known
    ]


async def _of_each(robot: Robot, node: str, kind: str, key: str, asked: Sequence[str]) -> dict[str, Any]:
    """Return the node's answer for each name; names without an answer are absent."""

    async def ask(wanted: Sequence[str]) -> Sequence[Any]:
        return (await _response(robot, node, kind, {"names": list(wanted)}))[key]

    return await by_name(ask, asked)


def _parameter(
    name: str, value: Mapping[str, Any] | None, descriptor: Mapping[str, Any], type_code: int = 0
) -> Parameter:
    """Return a parameter from its value and descriptor. If it is not set, `value` is None, and its
    type is that of its declaration.
    """
    value = value or {"type": 0}
    declared = parameters.type_name(int(value["type"]) or int(descriptor["type"]) or type_code)
    # A descriptor has at most one range, of either kind.
    ranges = (*descriptor["floating_point_range"], *descriptor["integer_range"])
    allowed = [{"from": entry["from_value"], "to": entry["to_value"], "step": entry["step"]} for entry in ranges]
    return Parameter(
        name=name,
        type="dynamic" if descriptor["dynamic_typing"] else declared,
        value=parameters.value_of(value),
        not_set=None if int(value["type"]) else True,
        description=descriptor["description"],
        read_only=descriptor["read_only"],
        range=allowed[0] if allowed else None,
        constraints=descriptor["additional_constraints"],
    )


async def _time_to_appear(robot: Robot) -> float:
    """Return how long to wait for the discovery of a service: the younger the bridge, the longer. Services are
    discovered after their nodes.
    """
    return max(APPEAR_S, _DISCOVERY_S - (await robot.graph.bridge_status()).uptime_s)


async def _response(robot: Robot, node: str, kind: str, request: Mapping[str, Any]) -> dict[str, Any]:
    """Return the answer, in full, of one of a node's parameter services that only read."""
    kind, wait_s = f"rcl_interfaces/srv/{kind}", await _time_to_appear(robot)
    asking = ask_node(robot, node, kind, request, timeout_s=TIMEOUT_S, wait_s=wait_s)
    return await fields_of_answer(robot, node, asking, _not_found)


async def _not_found(robot: Robot, node: str) -> NotFound:
    known = (await list_nodes(robot, include_hidden=True)).nodes
    if node in known:
        hint = "The node was started without them, or has just started: try again."
        return NotFound(f"{node} offers no parameter services.", hint)
    return NotFound(f"There is no node {node}.", await robot.graph.near(node, known, "ros2_node_list"))
