"""Eyes and hands on a ROS 2 robot: an MCP server (`python -m ros2_mcp`), and the same as a library.

The operations in `ros2_mcp.ops` are plain async functions: the first argument is the robot, the result a frozen
dataclass. They need no MCP, no sourced shell and no rclpy in this process::

    import asyncio
    from ros2_mcp import Settings, connect
    from ros2_mcp.ops.topics.list import list_topics

    async def main():
        async with connect(Settings(read_only=True)) as robot:
            listing = await list_topics(robot, pattern="scan")
            print([row.topic_name for row in listing.topics])

    asyncio.run(main())

`Settings(bag=Path("run.mcap"))` opens a recording instead. What goes wrong is a `RobotError`: its message says what,
its `hint` what would be right.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ros2_mcp.compose.robot import connect
    from ros2_mcp.model.errors import RobotError
    from ros2_mcp.robot import Robot
    from ros2_mcp.settings import Settings

__all__ = ["Robot", "RobotError", "Settings", "connect"]

_HOMES = {
    "Robot": "ros2_mcp.robot",
    "RobotError": "ros2_mcp.model.errors",
    "Settings": "ros2_mcp.settings",
    "connect": "ros2_mcp.compose.robot",
}


def __getattr__(name: str) -> Any:
    # Imported when asked for: the server starts its bridge before it imports what these need.
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
