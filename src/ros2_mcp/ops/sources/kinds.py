"""Which sources there are: one line for each kind."""

from __future__ import annotations

from collections.abc import AsyncGenerator

from ros2_mcp.model.errors import NotFound, RobotError
from ros2_mcp.ops.memory.bag_store import BagStore
from ros2_mcp.ops.sources.bag import Bags
from ros2_mcp.ops.sources.data_black_box import DataBlackBoxes
from ros2_mcp.ops.sources.live import Robots
from ros2_mcp.ops.sources.source import Source, SourceKind, SourceRequest
from ros2_mcp.robot import Robot

KINDS: list[SourceKind] = [
    DataBlackBoxes(),
    Bags(),
    Robots(),
]
"""In the order in which they are asked. The first that knows a name has it."""


async def open_source(robot: Robot, store: BagStore, name: str = "", start: str = "", end: str = "") -> Source:
    """The source of that name between two moments; without a name the recording that stands for the robot, else itself.

    Raises:
        BadInput: if moments are given, and no recording.
        NotFound, BadData, BadValue: as `open_bag`.
    """
    request = SourceRequest(name.strip(), start.strip(), end.strip())
    for kind in KINDS:
        if source := await kind.named(robot, store, request):
            return source
    raise NotFound(f"There is no source {name!r}.", "ros2_bag_list shows what can be read.")


async def sources_of_the_past(
    robot: Robot, store: BagStore, request: SourceRequest
) -> AsyncGenerator[Source | RobotError, None]:
    """One source after the other that may have messages of the past, or why it cannot be opened."""
    for kind in KINDS:
        try:
            openings = await kind.kept(robot, store, request)
        except RobotError as error:
            yield error
            continue
        for opening in openings:
            try:
                source = await opening()
            except RobotError as error:
                yield error
                continue
            yield source
