"""The tool that stops."""

from __future__ import annotations

from ros2_mcp.ops import stop as stopping
from ros2_mcp.robot import Robot
from ros2_mcp.tools.declare import tool

PLACE = 70


@tool(title="Stop the robot", risk="actuate")
async def ros2_stop(robot: Robot) -> stopping.Stopped:
    """Stop at once everything that this server has set in motion: zero on velocity topics, goals cancelled, repeated
    publishing and relays ended. Says what was confirmed.
    """
    return await stopping.stop(robot)
