"""Which source a question is about: the robot now, or a part of a recording."""

from __future__ import annotations

from dataclasses import dataclass

from ros2_mcp.model.errors import BadInput
from ros2_mcp.ops.live import Live
from ros2_mcp.ops.memory import BLACK_BOX, Memory
from ros2_mcp.ops.recorded import BagSource, open_source
from ros2_mcp.ops.window import Source
from ros2_mcp.robot import Robot


@dataclass(frozen=True, slots=True)
class Part:
    """A part of a recording; without a name it is of the black box if one is kept, and with nothing given of none.

    Of more than `longest_s` it is the beginning if a start is given, else the end.
    """

    bag: str = ""
    start: str = ""
    end: str = ""
    longest_s: float | None = None


async def source_of(robot: Robot, memory: Memory, part: Part, live_s: float) -> Source:
    """The recording that is named, or that stands for the robot; else the robot for the next `live_s` seconds.

    Raises:
        BadInput: if moments are given, and no recording.
        NotFound, BadData, BadValue: as `open_source`.
    """
    return await recorded_part(robot, memory, part) or Live(robot, live_s)


async def recorded_part(robot: Robot, memory: Memory, part: Part) -> BagSource | None:
    """The recording that is meant, or None where the robot itself is; raises as `source_of`."""
    name = part.bag.strip() or memory.subject_name
    if not name and (part.start.strip() or part.end.strip()):
        if BLACK_BOX not in memory.running:
            hint = "Name it with bag; ros2_bag_list shows which there are."
            raise BadInput("start and end are moments of a recording, and none is named.", hint)
        name = BLACK_BOX
    if not name:
        return None
    return await open_source(memory, name, part.start, part.end, robot, longest_s=part.longest_s)
