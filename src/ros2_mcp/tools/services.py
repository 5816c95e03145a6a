"""Tools that list and call services."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from ros2_mcp.ops.results.results import Report
from ros2_mcp.ops.services.call import ServiceAnswer, call
from ros2_mcp.ops.services.list import ServiceList, list_services
from ros2_mcp.robot import Robot
from ros2_mcp.robot.session import Session
from ros2_mcp.tools.arguments import Flag, Hidden, Limit, Number, Pattern
from ros2_mcp.tools.declare import tool
from ros2_mcp.tools.injection import Waits
from ros2_mcp_common.wire.limits import MAX_DURATION_S

PLACE = 80
_EMPTY = ("", "{}", "[]")


def _empty_request(value: Any) -> Any:
    """Treat an empty request ([] or "", as other servers and forms send it) as not given."""
    return None if value is None or value == [] or (isinstance(value, str) and value.strip() in _EMPTY) else value


@tool(
    title="List services",
    risk="read",
    group="services",
    program="services",
    finds="which services are there, list services",
)
async def ros2_service_list(
    robot: Robot, pattern: Pattern = "", include_hidden: Hidden = False, limit: Limit = 100
) -> ServiceList:
    """List the services of the robot with their types, request fields and the nodes that serve them."""
    return await list_services(robot, pattern, include_hidden, limit)


@tool(
    title="Call a service",
    risk="actuate",
    group="services",
    program="call",
    finds="call a service: take off, land, drone, arm, reset, enable, set mode",
)
async def ros2_service_call(
    robot: Robot,
    session: Session,
    report: Report,
    service_name: Annotated[str, Field(description="Such as /set_mode.")],
    fields: Annotated[
        dict[str, Any] | None,
        BeforeValidator(_empty_request),
        Field(description='Request fields, such as {"data": true}.'),
    ] = None,
    service_type: Annotated[str, Field(description="Such as std_srvs/srv/SetBool. Default: the service's own.")] = "",
    force_call: Annotated[
        Flag, Field(description="Call even if fields are missing, or several nodes serve it.")
    ] = False,
    timeout_sec: Annotated[Number, Field(gt=0, le=MAX_DURATION_S, description="Maximum wait in seconds.")] = 10.0,
    *,
    waits: Waits,
) -> ServiceAnswer:
    """Call a service and wait for its answer. Can move the robot.

    If request fields are missing, the service is not called, and the result names them.
    """
    return await call(
        robot,
        session,
        service_name,
        service_type,
        fields,
        force_call=force_call,
        timeout_s=timeout_sec,
        waits=waits,
        report=report,
    )
