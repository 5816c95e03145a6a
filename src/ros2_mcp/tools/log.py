"""The tool that reads the robot's log."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from ros2_mcp.ops import log
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
    program="log",
    finds="log, rosout, errors, warnings, what happened, what did nodes say",
)
async def ros2_log_read(
    robot: Robot,
    since: Since = "",
    node: Annotated[str, Field(description="Only of this node, such as /planner; also a part or a glob.")] = "",
    level: Annotated[str, Field(description="From this level on: debug, info, warn, error or fatal.")] = "",
    pattern: Annotated[str, Field(description="Only lines with this text, or a glob for the whole line.")] = "",
    limit: Annotated[Whole, Field(ge=1, le=5000, description="The newest so many.")] = 100,
    end: UpToLogEnd = "",
    *,
    selection: Selection,
    source: LogSource,
) -> log.Log:
    """Read what the robot's nodes have logged on /rosout: problems show here first.

    Lines are kept from the start of this server on (the newest 5000), and from a few seconds before. In a
    recording, seconds ago count back from its end.
    """
    request = log.LogRequest(since=since, until=end, node=node, level=level, pattern=pattern, limit=limit)
    if source.is_live:
        return await log.read(robot, request, selection.max_bytes)
    return await log.read_recorded(source, request, selection.max_bytes)
