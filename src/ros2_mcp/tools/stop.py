"""The tool that stops the robot."""

from __future__ import annotations

from ros2_mcp.ops.stop import stop as stopping
from ros2_mcp.robot import Robot
from ros2_mcp.robot.session import Session
from ros2_mcp.tools.declare import tool

PLACE = 70


@tool(
    title="Stop the robot",
    risk="stop",
    finds="stop, halt, emergency stop, freeze, cancel everything",
    always_loaded=True,
)
async def ros2_stop(robot: Robot, session: Session) -> stopping.Stopped:
    """Stop at once everything that this server has set in motion, for any client: publishes zero on velocity topics,
    cancels goals, ends repeated publishing, relays and playbacks; commands accepted earlier but not yet sent are
    dropped. Reports what was confirmed, whether odometry or joints show motion, and which called
    services and published topics it cannot stop.
    """
    return await stopping.stop_in_reach(robot, session.principal.name)
