"""Tools that list and call services."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from ros2_mcp.ops.results import Report
from ros2_mcp.ops.services.call import ServiceAnswer, call
from ros2_mcp.ops.services.list import ServiceList, list_services
from ros2_mcp.robot import Robot
from ros2_mcp.tools.arguments import Flag, Hidden, Limit, Number, Pattern
from ros2_mcp.tools.declare import tool
from ros2_mcp_bridge.limits import MAX_DURATION_S

PLACE = 80


def _empty_request(value: Any) -> Any:
    """One desktop client sends objects as texts. Here an empty one may be: nothing is called without its fields."""
    return {} if isinstance(value, str) and value.strip() == "{}" else value


@tool(title="List services", risk="read", group="services")
async def ros2_service_list(
    robot: Robot, pattern: Pattern = "", include_hidden: Hidden = False, limit: Limit = 100
) -> ServiceList:
    """List the services of the robot with their types, request fields and the nodes that serve them."""
    return await list_services(robot, pattern, include_hidden, limit)


@tool(title="Call a service", risk="actuate", group="services", aliases={"timeout": "timeout_sec"})
async def ros2_service_call(
    robot: Robot,
    report: Report,
    service_name: Annotated[str, Field(description="Name of the service, such as /set_mode.")],
    fields: Annotated[
        dict[str, Any],
        BeforeValidator(_empty_request),
        Field(description='The request\'s fields, such as {"data": true}.'),
    ],
    service_type: Annotated[
        str, Field(description="Type such as std_srvs/srv/SetBool. Leave it out to use the service's own.")
    ] = "",
    force_call: Annotated[
        Flag, Field(description="Call even if request fields are missing; they get defaults.")
    ] = False,
    timeout_sec: Annotated[
        Number, Field(gt=0, le=MAX_DURATION_S, description="Wait at most this long, in seconds.")
    ] = 10.0,
) -> ServiceAnswer:
    """Call a service and wait for its answer. Can move the robot.

    If request fields are missing it is not called: the answer names them.
    """
    return await call(
        robot, service_name, service_type, fields, force_call=force_call, timeout_s=timeout_sec, report=report
    )
