"""Plans that were sent before somebody asks for them (`robot/last_plans.py` keeps them)."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.nav2 import PATH
from ros2_mcp.ops.pictures.next_message import Next
from ros2_mcp.ops.sources.live import Live
from ros2_mcp.robot import Robot


async def hear_plans(robot: Robot) -> None:
    """Keeps the plans that are sent from now on, for pictures that are asked for later."""
    with suppress(RobotError):
        await robot.last_plans.hear(await Live(robot).publishing(PATH))


async def sent_before(robot: Robot, topic: str, type_name: str) -> tuple[Next, float] | None:
    """The plan or goal of a topic that was heard last, and how many s ago; None if none was, or it was taken back."""
    if not (heard := robot.last_plans.last(topic)) or heard[0] != type_name:
        return None
    try:
        message: Any = (await robot.values.decode_all(type_name, [heard[1]]))[0]
    except RobotError:
        return None
    if type_name == PATH and not message.poses:
        return None
    return Next(message, heard[1], "", ""), max(robot.now_ns() - heard[1].received_ns, 0) / 1e9
