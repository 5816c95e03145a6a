"""Services that a node provides for its own parameters and lifecycle, and the errors of calling them."""

from __future__ import annotations

import re
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from ros2_mcp.model.commands import Answer
from ros2_mcp.model.errors import NotFound, TimedOut
from ros2_mcp.robot import Robot

TIMEOUT_S = 5.0
"""Time-out of a call: a node that spins answers within milliseconds, and a node that is starting within seconds."""
APPEAR_S = 1.0
"""Time to discover a service of a node that has just started."""


def service_of(node: str, kind: str) -> str:
    """Return the service of a node with this type, from which its name follows: `get_state` for
    `lifecycle_msgs/srv/GetState`.
    """
    return f"{node}/{re.sub(r'(?<=[a-z])(?=[A-Z])', '_', kind.rpartition('/')[2]).lower()}"


async def ask_node(
    robot: Robot, node: str, kind: str, request: Mapping[str, Any], *, timeout_s: float, wait_s: float | None = None
) -> Answer:
    """Call a service of a node. Raises the same errors as `Robot.ask_service`."""
    return await robot.ask_service(service_of(node, kind), kind, request, timeout_s=timeout_s, wait_s=wait_s)


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
