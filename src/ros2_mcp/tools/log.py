"""The tool that reads the robot's log."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from ros2_mcp.ops import log
from ros2_mcp.ops.memory import Memory
from ros2_mcp.ops.sources import Part, recorded_part
from ros2_mcp.robot import Robot
from ros2_mcp.tools.arguments import FromBag, UpToEnd, Whole
from ros2_mcp.tools.declare import tool


def _as_text(value: Any) -> Any:
    return str(value) if isinstance(value, (int, float)) and not isinstance(value, bool) else value


Since = Annotated[
    str,
    BeforeValidator(_as_text),
    Field(description='Seconds ago, such as "30", or a time like "2030-01-31T12:00:00Z". Default: all that is kept.'),
]


@tool(title="Read the log", risk="read", recorded=True)
async def ros2_log_read(
    robot: Robot,
    memory: Memory,
    since: Since = "",
    node: Annotated[str, Field(description="Only of this node, such as /planner; also a part or a glob.")] = "",
    level: Annotated[str, Field(description="From this level on: debug, info, warn, error or fatal.")] = "",
    pattern: Annotated[str, Field(description="Only lines with this text, or a glob for the whole line.")] = "",
    limit: Annotated[Whole, Field(ge=1, le=5000, description="The newest so many.")] = 100,
    bag: FromBag = "",
    end: UpToEnd = "",
) -> log.Log:
    """Read what the robot's nodes have logged on /rosout: problems show here first.

    Lines are kept from the start of this server on (the newest 5000), and from a few seconds before. In a
    recording, since counts back from its end.
    """
    wanted = log.Wanted(since, node, level, pattern, limit)
    start = since if not _is_number(since) else f"{since} s ago"
    about_recording = bag or end or memory.subject_name
    recorded = await recorded_part(robot, memory, Part(bag, start, end)) if about_recording else None
    return await (log.read_recorded(recorded, wanted, robot.result_bytes) if recorded else log.read(robot, wanted))


def _is_number(text: str) -> bool:
    return text.strip().replace(".", "", 1).isdigit()
