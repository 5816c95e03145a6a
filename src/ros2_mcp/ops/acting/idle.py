"""Reasons why a command may have no effect: a controller, hardware component or node is not active, or a node is
frozen.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from typing import Any

from ros2_mcp.model.errors import NotFound, RobotError, TimedOut
from ros2_mcp.model.text import named
from ros2_mcp.ops.space.controllers import LIST_CONTROLLERS
from ros2_mcp.robot import MOTION_TYPES, Robot

COMMAND_TYPES = frozenset((*MOTION_TYPES, "std_msgs/msg/Float64MultiArray", "control_msgs/msg/MultiDOFCommand"))
"""Command types to which controllers of ros2_control subscribe. For other types no controller manager is asked."""
_LIST = "controller_manager_msgs/srv/ListControllers"
_HARDWARE, _LIST_HARDWARE = "/list_hardware_components", "controller_manager_msgs/srv/ListHardwareComponents"
_STATE, _GET_STATE = "/get_state", "lifecycle_msgs/srv/GetState"
_PARAMETERS, _GET_PARAMETERS = "/get_parameters", "rcl_interfaces/srv/GetParameters"
_ANSWER_S = 0.7
"""Time-out of each question: a live node answers within milliseconds, the first time after 0.1 s of discovery."""
_MOST_NODES = 4
"""The most nodes that are asked for a sign of life: the subscribers of a command are a base,
perhaps a recorder and a filter."""
_ACTIVE = "active"


async def why_idle(
    robot: Robot, commands: str = "", feedback: str = "", action: str = "", *, is_in_doubt: bool = False
) -> str:
    """Return sentences on what keeps nodes from acting: inactive controllers and hardware components, as their
    controller managers report, and inactive lifecycle nodes. Empty if nothing does, or if it is unknown.

    The nodes in question are the subscribers of the topic `commands`, the publishers of the topic `feedback`, and the
    server of `action`.

    `is_in_doubt`: something did not move. Then nodes that no controller manager reports on are also checked for a sign
    of life. Takes up to some tenths of a second, 1.5 s if a node is frozen. Raises no `RobotError`.
    """
    try:
        rows = await robot.graph.services()
        services = {row.name for row in rows}
        hosts = [name.removesuffix(LIST_CONTROLLERS) for name in services if name.endswith(LIST_CONTROLLERS)]
        managed = {row.name.removesuffix(_STATE) for row in rows if _GET_STATE in row.types}
        if not (hosts or managed or is_in_doubt):
            return ""
        nodes = await _nodes(robot, commands, feedback, action)
        told = [await _by_its_list(robot, host, nodes, services) for host in sorted(hosts)[:2]]
        unnamed = [node for node in sorted(managed & nodes) if not any(named(node) in text for text in told)]
        told += await asyncio.gather(*(_by_its_state(robot, node) for node in unnamed[:_MOST_NODES]))
    except RobotError:  # what was sent is sent, and is to be told
        return ""
    if is_in_doubt and not any(told):
        told = await asyncio.gather(*(_sign_of_life(robot, node, services) for node in sorted(nodes)[:_MOST_NODES]))
    return " ".join(filter(None, told))


async def with_reason(
    robot: Robot, error: NotFound | TimedOut, commands: str = "", feedback: str = "", action: str = ""
) -> RobotError:
    """Return the same error with a reason added: why the nodes that did not answer cannot act."""
    why = await why_idle(robot, commands, feedback, action, is_in_doubt=True)
    return type(error)(f"{error.message} {why}".rstrip(), error.hint)


async def _nodes(robot: Robot, commands: str, feedback: str, action: str) -> set[str]:
    """Return the nodes that receive the commands, and the nodes that publish the feedback."""
    found: set[str] = set()
    if commands:
        found |= {one.node for one in (await robot.graph.endpoints(commands)).subscribers if not one.ours}
    for topic in filter(None, (feedback, f"{action}/_action/status" if action else "")):
        found |= {one.node for one in (await robot.graph.endpoints(topic)).publishers if not one.ours}
    return found


async def _by_its_list(robot: Robot, host: str, nodes: set[str], services: set[str]) -> str:
    """Return what a controller manager, the node `host`, reports of the controllers among these nodes, as sentences."""
    try:
        answer = await _asked(robot, f"{host}{LIST_CONTROLLERS}", _LIST)
    except TimedOut:
        within = f"{host.rpartition('/')[0]}/"
        is_theirs = any(node.startswith(within) for node in nodes)
        return f"{named(host)} does not answer: it is frozen, or very busy." if is_theirs else ""
    except RobotError:
        return ""
    controllers: dict[str, Mapping[str, Any]] = {str(one["name"]): one for one in answer["controller"]}
    namespace = host.rpartition("/")[0]
    meant = [name for name in controllers if f"{namespace}/{name}" in nodes]
    chain = _below(controllers, meant)
    inactive = [name for name in chain if controllers[name]["state"] != _ACTIVE]
    if inactive:
        states = [
            f"{named(f'{namespace}/{name}')} is not active: it is {named(str(controllers[name]['state']))}"
            for name in inactive
        ]
        return f"{'; '.join(states)}. Its controller manager {named(host)} activates it (switch_controller)."
    if not chain or f"{host}{_HARDWARE}" not in services:
        return ""
    try:
        components = (await _asked(robot, f"{host}{_HARDWARE}", _LIST_HARDWARE))["component"]
    except RobotError:
        return ""
    told: list[str] = []
    for name in meant:
        used = {interface for each in _below(controllers, [name]) for interface in _interfaces(controllers[each])}
        told += [
            f"{named(f'{namespace}/{name}')} is active, its hardware {named(str(one['name']))} is "
            f"{named(str(one['state']['label']))}: nothing moves until it is active (set_hardware_component_state)."
            for one in components
            if one["state"]["label"] != _ACTIVE and used & {str(each["name"]) for each in one["command_interfaces"]}
        ]
    return " ".join(told)


def _below(controllers: Mapping[str, Mapping[str, Any]], meant: Sequence[str]) -> Sequence[str]:
    """Return these controllers and the chained controllers below them. An interface of a chained controller begins with
    its name.
    """
    found = list(meant)
    for name in found:  # grows during the iteration
        through = {interface.partition("/")[0] for interface in _interfaces(controllers[name])}
        found += [other for other in controllers if other in through and other not in found]
    return found


def _interfaces(controller: Mapping[str, Any]) -> Sequence[str]:
    """Return the interfaces that a controller commands: those claimed while it is active, and those always required."""
    return [*controller["claimed_interfaces"], *controller["required_command_interfaces"]]


async def _by_its_state(robot: Robot, node: str) -> str:
    """A sentence where a lifecycle node is not active."""
    try:
        state = str((await _asked(robot, f"{node}{_STATE}", _GET_STATE))["current_state"]["label"])
    except RobotError:
        return ""
    if state == _ACTIVE:
        return ""
    return f"{named(node)} is not active: it is {named(state)}. ros2_lifecycle_change activates it."


async def _sign_of_life(robot: Robot, node: str, services: set[str]) -> str:
    """Return a sentence if a node does not answer get_parameters, which every node serves; else nothing."""
    service = f"{node}{_PARAMETERS}"
    if service not in services:
        return ""
    try:
        await _asked(robot, service, _GET_PARAMETERS, {"names": []})
    except TimedOut:
        return f"{named(node)} does not answer: it is frozen, or very busy."
    except RobotError:
        pass
    return ""


async def _asked(robot: Robot, service: str, service_type: str, request: Mapping[str, Any] | None = None) -> Any:
    """Return the answer of a service that only reads. Raises `TimedOut`, also if discovery takes too long."""
    try:
        asked = robot.ask_service(service, service_type, request or {}, timeout_s=_ANSWER_S)
        return await robot.fields_of(await asyncio.wait_for(asked, 2 * _ANSWER_S))
    except asyncio.TimeoutError as error:
        raise TimedOut(f"{service} did not answer.") from error
