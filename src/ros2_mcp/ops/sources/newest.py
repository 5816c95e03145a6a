"""The live robot for readers that read several times a second: a topic that was read stays subscribed."""

from __future__ import annotations

import copy
from collections.abc import AsyncGenerator, Sequence
from contextlib import aclosing, asynccontextmanager
from time import monotonic
from typing import TYPE_CHECKING

from ros2_mcp.model import names
from ros2_mcp.model.samples import Sample
from ros2_mcp.ops.sources.live import Live
from ros2_mcp.ops.sources.newest_samples import newest_of
from ros2_mcp.ops.sources.source import GraphSnapshot, Source, Stream
from ros2_mcp.robot import Robot
from ros2_mcp.robot.transforms import TransformListener

if TYPE_CHECKING:
    from ros2_mcp.values.cdr import Codec

_FIRST_S = 0.3
"""Time for the first message of a topic: a later message is shown with the next read, and delays nothing else."""
_LISTED_S = 1.0
"""Age at which the list of topics is read again: a person can wait a second for a new topic."""


class NewestOfRobot(Source):
    """A source that gives only the newest message of each topic, at once if a message has arrived before."""

    title = "the robot"
    words = "live"
    is_live = True
    duration_s = _FIRST_S

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._live = Live(robot)
        self._codec: Codec | None = None
        self._listed: dict[tuple[str, ...], tuple[float, list[str]]] = {}

    @property
    def codec(self) -> Codec:
        """The codec for its samples; it decodes each once."""
        if self._codec is None:
            from ros2_mcp.values.cdr import RememberingCodec  # with numpy: not at the start

            self._codec = RememberingCodec(self._robot.values.definitions)
        return self._codec

    @property
    def transforms(self) -> TransformListener:
        """The listener of the robot's transforms."""
        return self._robot.transforms

    async def type_of(self, topic: str) -> str:
        """Return the type of a topic, as `Source.type_of`."""
        return await self._live.type_of(topic)

    async def graph(self) -> GraphSnapshot:
        """Return the present graph."""
        return await self._live.graph()

    def lasting(self, live_s: float, *, recorded_s: float | None = None, whole: bool = False) -> Source:  # noqa: ARG002
        """Return the same source. Its first message is not awaited for longer than `_FIRST_S`."""
        found = copy.copy(self)
        found.duration_s = min(live_s, _FIRST_S)
        return found

    async def publishing(self, *types: str) -> list[str]:
        """Return the published topics with one of these types, as they were a second ago at most."""
        at, found = self._listed.get(types, (0.0, []))
        if not at or monotonic() - at > _LISTED_S:
            found = await self._live.publishing(*types)
            self._listed[types] = monotonic(), found
        return found

    @asynccontextmanager
    async def follow(
        self,
        topic: str,
        type_name: str = "",
        *,
        limit: int | None = None,  # noqa: ARG002 - there is one
        every_n: int = 1,  # noqa: ARG002
        latched: bool = True,  # noqa: ARG002
        times_only: bool = False,  # noqa: ARG002
    ) -> AsyncGenerator[Stream, None]:
        """Give the newest message. Raises the same errors as `Source.follow`."""
        topic = names.absolute(topic)
        newest = newest_of(self._robot, topic)
        sample = newest.sample or await newest.newer(None, max(newest.since + self.duration_s - monotonic(), 0.0))
        if newest.error:
            raise newest.error.again()
        listening = newest.listening
        kind = listening.type if listening else type_name or await self.type_of(topic)
        publishers = listening.publishers if listening else ()
        stream = Stream(
            topic=topic,
            type=kind,
            codec=self.codec,
            publishers=publishers,
            until_ns=self._robot.now_ns(),
            asked_ns=newest.opened_ns,
        )
        stream.batches = _one(sample)
        async with aclosing(stream.batches):
            yield stream


async def _one(sample: Sample | None) -> AsyncGenerator[Sequence[Sample], None]:
    if sample:
        yield [sample]
