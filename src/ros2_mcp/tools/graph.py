"""Tools that show the server itself and the interfaces of the robot."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from ros2_mcp.ops.graph import interfaces, status
from ros2_mcp.robot import Robot
from ros2_mcp.tools.arguments import Limit, Pattern
from ros2_mcp.tools.declare import tool
from ros2_mcp.tools.injection import Limitations

PLACE = 12
"""After the tools for nodes; ros2_status has a place of its own before them."""


@tool(
    title="Server and robot status",
    risk="read",
    place=10,
    finds="connection, is ROS running, bridge, distribution, domain, middleware",
)
async def ros2_status(robot: Robot, limitations: Limitations) -> status.Status:
    """Show which ROS 2 this server uses (distribution, middleware, domain), its health, and what it cannot do."""
    return await status.status(robot, limitations)


@tool(
    title="Definition of an interface",
    risk="read",
    recorded=True,
    aliases={"msg_type": "message_type"},
    finds="message definition, fields of a type, example value, msg srv action",
)
async def ros2_get_message_fields(
    robot: Robot,
    message_type: Annotated[
        str,
        Field(description="A message, service or action type, such as geometry_msgs/msg/Twist or std_srvs/SetBool."),
    ],
) -> interfaces.Definition:
    """Show the full definition of a type, with all parts and nested types, with an example value ready to fill in."""
    return await interfaces.define(robot, message_type)


@tool(
    title="List interfaces", risk="read", recorded=True, finds="which message, service and action types are installed"
)
async def ros2_interface_list(
    robot: Robot,
    pattern: Pattern = "",
    kind: Annotated[str, Field(description="Only this kind: msg, srv or action.")] = "",
    package: Annotated[str, Field(description="Only this package, such as std_msgs.")] = "",
    limit: Limit = 200,
) -> interfaces.InterfaceList:
    """List the message, service and action types installed on the robot, or stored in the recording."""
    return await interfaces.list_interfaces(robot, pattern, kind, package, limit)
