"""Carrying out the commands that are requests to services; which services may be asked without a command."""

from __future__ import annotations

from typing import Any

from ros2_mcp.model.commands import Answer, CancelGoals, SendGoal, ServiceBorne
from ros2_mcp.robot.core import Core

_READING_TYPES = frozenset(
    {
        "rcl_interfaces/srv/DescribeParameters",
        "rcl_interfaces/srv/GetParameterTypes",
        "rcl_interfaces/srv/GetParameters",
        "rcl_interfaces/srv/ListParameters",
        "lifecycle_msgs/srv/GetAvailableStates",
        "lifecycle_msgs/srv/GetAvailableTransitions",
        "lifecycle_msgs/srv/GetState",
        "type_description_interfaces/srv/GetTypeDescription",
        "lora_msgs/srv/GetMessages",
        "wisevision_msgs/srv/InfluxGetMessages",
    }
)
"""Types of services whose definition says that they read something and change nothing; the last two are those of the
Data Black Box."""


def only_reads(service_type: str) -> bool:
    """Whether a service of that type reads something and changes nothing; asking for the result of a goal does, too."""
    return service_type in _READING_TYPES or ("/action/" in service_type and service_type.endswith("_GetResult"))


async def call(core: Core, command: ServiceBorne) -> Answer:
    """The answer to one request, which is checked against its definition. Raises as a `ServiceBorne`.

    Raises:
        BadValue: naming the path of a value that does not fit; nothing is sent.
        Stopped: if a stop came after it was accepted; nothing was sent.
    """
    timeout_s, wait_s = command.timeout_s, command.wait_s
    body = await core.values.encode(f"{command.service_type}_Request", command.request)
    arguments: dict[str, Any] = {
        "service": command.service,
        "type": command.service_type,
        "wait_s": timeout_s if wait_s is None else wait_s,
        "timeout_s": timeout_s,
        "within_s": timeout_s if wait_s is None else wait_s + timeout_s,
    }
    if isinstance(command, CancelGoals) or only_reads(command.service_type):
        reply = await core.graph.ask("call", body, **arguments)
    elif isinstance(command, SendGoal):  # it is a job, and cancelled whatever becomes of this request
        reply = await core.graph.ask("call", body, epoch=core.check_stop().epoch, **arguments)
    else:
        with core.no_known_stop.sending("service", f"{command.service} ({command.service_type})"):
            reply = await core.act("call", body, **arguments)
    return Answer(f"{command.service_type}_Response", reply.body, reply.ok["elapsed_s"])
