"""The tool that reads the robot's log."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from ros2_mcp.ops.log import read as log
from ros2_mcp.ops.sources.selection import Selection
from ros2_mcp.robot import Robot
from ros2_mcp.tools.arguments import Since, UpToLogEnd, Whole
from ros2_mcp.tools.declare import tool
from ros2_mcp.tools.injection import LogSource

PLACE = 50


@tool(
    title="Read the log",
    risk="read",
    recorded=True,
    aliases={"node": "node_name"},
    program="log",
    finds="log, rosout, errors, warnings, what happened, what did nodes say",
)
async def ros2_log_read(
    robot: Robot,
    since: Since = "",
    node_name: Annotated[
        str, Field(description="Only lines of this node, such as /planner; or a part of its name, or a glob.")
    ] = "",
    level: Annotated[str, Field(description="Minimum level: debug, info, warn, error or fatal.")] = "",
    pattern: Annotated[str, Field(description="Only lines with this text, or a glob for the whole line.")] = "",
    limit: Annotated[Whole, Field(ge=1, le=5000, description="Number of newest lines to return.")] = 100,
    end: UpToLogEnd = "",
    *,
    selection: Selection,
    source: LogSource,
) -> log.Log:
    """Read what the robot's nodes logged on /rosout. Problems appear here first.

    The server keeps the newest 5000 lines since it started, and those of a few seconds before. In a recording, seconds
    ago are counted from its end.
    """
    request = log.LogRequest(since=since, until=end, node=node_name, level=level, pattern=pattern, limit=limit)
    if source.is_live:
        return await log.read(robot, request, selection.max_bytes)
    return await log.read_recorded(source, request, selection.max_bytes)
