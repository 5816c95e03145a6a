"""Carrying out the commands that are requests to services, and asking those that only tell something."""

from __future__ import annotations

from ros2_mcp.model.commands import Answer, ServiceBorne
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
"""Types of services whose definition says that they tell something and change nothing; the last two are those of the
Data Black Box."""


def only_tells(service_type: str) -> bool:
    """Whether a service of that type tells something and changes nothing; the result of a goal does, too."""
    return service_type in _READING_TYPES or ("/action/" in service_type and service_type.endswith("_GetResult"))


async def call(core: Core, command: ServiceBorne) -> Answer:
    """A request to a service, checked against its definition."""
    return await request(
        core, command.service, command.service_type, command.request, timeout_s=command.timeout_s, wait_s=command.wait_s
    )


async def request(
    core: Core, service: str, service_type: str, value: object, *, timeout_s: float, wait_s: float | None
) -> Answer:
    """The answer to one request; without `wait_s` the time-out holds for waiting for a server and its answer together.

    Raises:
        NotFound: if no server appeared in time, or it left before it answered.
        TimedOut: if it did not answer in time.
        BadValue: naming the path of a value that does not fit; nothing is sent.
    """
    body = await core.values.encode(f"{service_type}_Request", value)
    reply = await core.graph.ask(
        "call",
        body,
        service=service,
        type=service_type,
        wait_s=timeout_s if wait_s is None else wait_s,
        timeout_s=timeout_s,
        within_s=timeout_s if wait_s is None else wait_s + timeout_s,
    )
    return Answer(f"{service_type}_Response", reply.body, reply.ok["elapsed_s"])
