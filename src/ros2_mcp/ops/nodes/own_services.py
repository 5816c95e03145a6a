"""The services that a node has of itself, for its parameters and its lifecycle, and the errors that they end with."""

from __future__ import annotations

import re
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from ros2_mcp.model.commands import Answer
from ros2_mcp.model.errors import NotFound, TimedOut
from ros2_mcp.robot import Robot

TIMEOUT_S = 5.0
"""A node that spins answers within milliseconds, and one that is starting up within seconds."""
APPEAR_S = 1.0
"""For a service of a node that has only just come up."""


def service_of(node: str, kind: str) -> str:
    """The service of a node whose name follows from its type: of `lifecycle_msgs/srv/GetState` it is `get_state`."""
    return f"{node}/{re.sub(r'(?<=[a-z])(?=[A-Z])', '_', kind.rpartition('/')[2]).lower()}"


async def ask_node(
    robot: Robot, node: str, kind: str, request: Mapping[str, Any], *, timeout_s: float, wait_s: float | None = None
) -> Answer:
    """Asks a service of a node; raises as `Robot.ask_service`."""
    return await robot.ask_service(service_of(node, kind), kind, request, timeout_s=timeout_s, wait_s=wait_s)


async def fields_of_answer(
    robot: Robot,
    node: str,
    answering: Awaitable[Answer],
    not_found: Callable[[Robot, str], Awaitable[NotFound]],
    timeout_s: float = TIMEOUT_S,
    unanswered: str = "",
) -> dict[str, Any]:
    """The fields of a node's answer, with errors that speak of the node: the user asked for it, not for a service.

    `unanswered` says what may follow where no answer came in time: what writes may have been done all the same.

    Raises:
        NotFound: made by `not_found`, if the node is not there or has no such service.
        TimedOut: if it did not answer in time.
    """
    try:
        return await robot.fields_of(await answering)
    except NotFound as error:
        raise await not_found(robot, node) from error
    except TimedOut as error:
        raise TimedOut(f"{node} did not answer within {timeout_s:g} s: it is busy, or it hangs.", unanswered) from error
