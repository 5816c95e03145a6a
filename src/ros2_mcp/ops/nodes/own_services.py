"""Services that a node provides for its own parameters and lifecycle, and the errors of calling them."""

from __future__ import annotations

import re
from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import Any

from ros2_mcp.model import parameters
from ros2_mcp.model.commands import Answer
from ros2_mcp.model.errors import NotFound, TimedOut
from ros2_mcp.robot import Robot

Ask = Callable[[Sequence[str]], Awaitable[Sequence[Any]]]
"""Requests something about parameters with these names; the answer has one entry for each, or fewer."""
TIMEOUT_S = 5.0
"""Time-out of a call: a node that spins answers within milliseconds, and a node that is starting within seconds."""
APPEAR_S = 1.0
"""Time to discover a service of a node that has just started."""


def service_of(node: str, kind: str) -> str:
    """Return the name of a node's service of this type: `/node/get_state` for `lifecycle_msgs/srv/GetState`."""
    return f"{node}/{re.sub(r'(?<=[a-z])(?=[A-Z])', '_', kind.rpartition('/')[2]).lower()}"


async def ask_node(
    robot: Robot, node: str, kind: str, request: Mapping[str, Any], *, timeout_s: float, wait_s: float | None = None
) -> Answer:
    """Call a service of a node. Raises the same errors as `Robot.ask_service`."""
    return await robot.ask_service(service_of(node, kind), kind, request, timeout_s=timeout_s, wait_s=wait_s)


async def parameter_values(
    robot: Robot, node: str, asked: Sequence[str], *, timeout_s: float, wait_s: float | None = None
) -> dict[str, Any]:
    """Return the values of a node's parameters by name; parameters that do not exist or are not set are absent. The
    time-out applies to each request. Raises the same errors as `Robot.ask_service`.
    """

    def asking(kind: str, key: str) -> Ask:
        async def ask(wanted: Sequence[str]) -> Sequence[Any]:
            request = {"names": list(wanted)}
            answer = await ask_node(
                robot, node, f"rcl_interfaces/srv/{kind}", request, timeout_s=timeout_s, wait_s=wait_s
            )
            return (await robot.fields_of(answer))[key]

        return ask

    return await set_values(asking("GetParameters", "values"), asking("GetParameterTypes", "types"), asked)


async def set_values(get: Ask, types: Ask, asked: Sequence[str]) -> dict[str, Any]:
    """Return the values that `get` answers, by name. If its answer is too short, `types` shows which parameters are not
    set.
    """
    answers = await get(asked) if asked else ()
    if len(answers) != len(asked):  # one request more for the types, in place of a dozen in halves
        kinds = await types(asked)
        is_known = len(kinds) == len(asked)
        asked = [name for name, kind in zip(asked, kinds, strict=True) if int(kind)] if is_known else asked
        found = await by_name(get, asked)
    else:
        found = dict(zip(asked, answers, strict=True))
    return {name: parameters.value_of(value) for name, value in found.items() if int(value["type"])}


async def by_name(ask: Ask, asked: Sequence[str]) -> dict[str, Any]:
    """Return the node's answer for each name; names without an answer are absent.

    One parameter that is declared but not set makes rclcpp and rclpy answer for none (or leave out those after it). So
    if the answer is shorter than the request, it is requested again in halves.
    """
    if not asked:
        return {}
    answers = await ask(asked)
    if len(answers) == len(asked):
        return dict(zip(asked, answers, strict=True))
    if len(asked) == 1:
        return {}
    middle = len(asked) // 2
    first = await by_name(ask, asked[:middle])  # in turn: a node gets one request at a time
    return first | await by_name(ask, asked[middle:])


async def fields_of_answer(
    robot: Robot,
    node: str,
    answering: Awaitable[Answer],
    not_found: Callable[[Robot, str], Awaitable[NotFound]],
    timeout_s: float = TIMEOUT_S,
    unanswered: str = "",
) -> dict[str, Any]:
    """Return the fields of a node's answer. The errors name the node: the user asked for a node, not for a service.

    `unanswered` is the hint for an answer that did not come in time: a write may have been carried out all the same.

    Raises:
        NotFound: made by `not_found`, if the node does not exist or has no such service.
        TimedOut: if it did not answer in time.
    """
    try:
        return await robot.fields_of(await answering)
    except NotFound as error:
        raise await not_found(robot, node) from error
    except TimedOut as error:
        raise TimedOut(f"{node} did not answer within {timeout_s:g} s: it is busy, or it hangs.", unanswered) from error
