"""All sources that a server can read, of every kind that it has."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Sequence
from dataclasses import dataclass

from ros2_mcp.model.aside import load
from ros2_mcp.model.errors import NotFound, RobotError
from ros2_mcp.ops.memory.bag_store import BagStore
from ros2_mcp.ops.results.results import Report, silent
from ros2_mcp.ops.sources.bag import Bags
from ros2_mcp.ops.sources.live import Robots
from ros2_mcp.ops.sources.source import Source, SourceKind, SourceRequest
from ros2_mcp.robot import Robot

OWN_KINDS: Sequence[SourceKind] = (Bags(), Robots())
"""The kinds that have no further dependencies. `compose/server.py` puts vendors' kinds before them."""


@dataclass(frozen=True, slots=True)
class Sources:
    """The sources of one server. `kinds` are asked in order; the first that knows a name provides the source."""

    robot: Robot
    store: BagStore
    kinds: Sequence[SourceKind] = OWN_KINDS

    async def open(
        self,
        name: str = "",
        start: str = "",
        end: str = "",
        *,
        names: tuple[str, str] = ("start", "end"),
        waits: bool = True,
        report: Report = silent,
    ) -> Source:
        """Return the source of that name between two times; the other arguments are as in `SourceRequest`.

        Without a name, return the recording that stands for the robot, else the robot itself.

        Raises:
            BadInput: if times are given without a recording.
            NotFound, BadData, BadValue: as by `open_bag`.
        """
        await load("ros2_mcp.values.cdr", "ros2_mcp.values.select")  # for decoding: with numpy, not at the start
        times = start.strip(), end.strip()
        request = SourceRequest(name.strip(), *times, names=names, waits=waits, report=report)
        for kind in self.kinds:
            if source := await kind.named(self.robot, self.store, request):
                return source
        raise NotFound(f"There is no source {name!r}.", "ros2_bag_list lists what can be read.")

    async def of_the_past(self, request: SourceRequest) -> AsyncGenerator[Source | RobotError, None]:
        """Yield the sources that may have earlier messages, one after the other; for a source
        that cannot be opened, the error.
        """
        for kind in self.kinds:
            try:
                openings = await kind.kept(self.robot, self.store, request)
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
