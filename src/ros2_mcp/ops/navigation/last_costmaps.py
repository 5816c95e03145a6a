"""Keeps costmaps current that are published in full once and then in parts: the server subscribes on the first
request."""

from __future__ import annotations

import asyncio
import logging
from collections import deque
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from time import monotonic
from typing import TYPE_CHECKING, Any

import anyio

from ros2_mcp.model.aside import aside, load
from ros2_mcp.model.errors import BadData, RobotError
from ros2_mcp.model.samples import Sample
from ros2_mcp.robot import Robot
from ros2_mcp.robot.kept import Kept
from ros2_mcp.robot.values import Values
from ros2_mcp_common.wire.protocol import Keep

if TYPE_CHECKING:
    from ros2_mcp.world.costmap import CostGrid

_IDLE_S = 120.0
"""Time after the last request until the subscription ends. A rolling costmap is published several times a second, so
that receiving it has a cost."""
_TURN_S = 5.0
"""Period of checking whether the subscription is still needed if no message arrives."""
_MOST = 4
"""Number of costmaps that are kept: a robot has a global and a local costmap."""
_MOST_RECENT = 4
"""Number of updates kept in case they arrive before the full costmap that they belong to."""
_logger = logging.getLogger(__name__)

Take = Callable[[str, Sample], Awaitable[None]]


@dataclass(eq=False)
class LastCostmap:
    """One costmap that is kept current.

    `grid` is the full costmap with all received updates applied, `whole` the sample of the full costmap, `update` that
    of the last of `updates` updates. `since_ns` is when the subscription to updates began, on the robot's clock.
    `refused` says why an update was not applied.
    """

    topic: str
    values: Values
    since_ns: int
    grid: CostGrid | None = None
    whole: Sample | None = None
    update: Sample | None = None
    updates: int = 0
    refused: str = ""
    error: RobotError | None = None
    asked_at: float = field(default_factory=monotonic)
    work: tuple[asyncio.Task[None], ...] = ()
    came: asyncio.Event = field(default_factory=asyncio.Event)
    _taking: asyncio.Lock = field(default_factory=asyncio.Lock)
    _recent: deque[tuple[str, Sample]] = field(default_factory=lambda: deque[tuple[str, Sample]](maxlen=_MOST_RECENT))

    @property
    def is_heard(self) -> bool:
        """Whether the subscriptions are running."""
        return all(not task.done() for task in self.work)

    @property
    def newest_ns(self) -> int:
        """When the newest message was sent; 0 without messages."""
        return max((sent_ns(one) for one in (self.whole, self.update) if one), default=0)

    @property
    def is_complete(self) -> bool:
        """Whether all updates since the full costmap were received and applied."""
        return self.whole is not None and sent_ns(self.whole) > self.since_ns and not self.refused

    async def take_whole(self, type_name: str, sample: Sample) -> None:
        """Take a full costmap, and apply the recent updates that are newer."""
        from ros2_mcp.world.cost_updates import as_grid

        async with self._taking:  # a large update takes longer to decode than a small one after it; keep their order
            message: Any = (await self.values.decode_all(type_name, [sample]))[0]
            self.grid = await aside(len(sample.data), as_grid, type_name, message)
            self.whole, self.update, self.updates, self.refused = sample, None, 0, ""
            for kind, part in self._recent:
                await self._apply(kind, part)
        self._tell()

    async def take_part(self, type_name: str, sample: Sample) -> None:
        """Take an update."""
        async with self._taking:
            self._recent.append((type_name, sample))
            await self._apply(type_name, sample)
        self._tell()

    async def _apply(self, type_name: str, sample: Sample) -> None:
        from ros2_mcp.world.cost_updates import updated

        if self.grid is None or self.whole is None or sent_ns(sample) < sent_ns(self.whole):
            return
        message: Any = (await self.values.decode_all(type_name, [sample]))[0]
        try:
            self.grid = updated(self.grid, type_name, message)
        except BadData as error:
            self.refused = error.message
            return
        self.update, self.updates = sample, self.updates + 1

    def _tell(self) -> None:
        self.came.set()
        self.came = asyncio.Event()

    async def wait(self, condition: Callable[[], bool], timeout_s: float) -> None:
        """Wait until the condition holds, the subscription ends, or the time is over."""
        with anyio.move_on_after(timeout_s):
            while not condition() and self.is_heard:
                await self.came.wait()

    def end(self) -> None:
        """End the subscriptions."""
        for task in self.work:
            task.cancel()
        self._tell()


class LastCostmaps(Kept):
    """The costmaps of a robot, each kept from the first request until there was none for a while."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._kept: dict[str, LastCostmap] = {}

    async def last(
        self, topic: str, updates_topic: str, wait_s: float, *, first_s: float, newer_s: float = 0.0
    ) -> LastCostmap:
        """Return a costmap with its updates.

        Wait up to `wait_s` for a full one, and then for a message newer than this call: up to `newer_s`, on the first
        request at least `first_s`.

        Raises:
            RobotError: if one of the two topics cannot be subscribed to.
        """
        await load("ros2_mcp.world.cost_updates")  # with numpy: not before it is needed
        kept, asked_ns = self._kept.get(topic), self._robot.now_ns()
        if kept is None or not kept.is_heard:
            kept, newer_s = self._begun(topic, updates_topic), max(first_s, newer_s)
        kept.asked_at = monotonic()
        await kept.wait(lambda: kept.grid is not None, wait_s)
        await kept.wait(lambda: kept.newest_ns >= asked_ns, newer_s)
        if kept.error:
            raise kept.error
        return kept

    def _begun(self, topic: str, updates_topic: str) -> LastCostmap:
        self._kept.pop(topic, None)
        if len(self._kept) >= _MOST:
            oldest = min(self._kept.values(), key=lambda one: one.asked_at)
            self._kept.pop(oldest.topic).end()
        kept = self._kept[topic] = LastCostmap(topic, self._robot.values, self._robot.now_ns())
        kept.work = (
            asyncio.create_task(self._follow(kept, updates_topic, "all", kept.take_part)),
            asyncio.create_task(self._follow(kept, topic, "latest", kept.take_whole)),
        )
        return kept

    async def close(self) -> None:
        """End all subscriptions."""
        for kept in self._kept.values():
            kept.end()

    async def _follow(self, kept: LastCostmap, topic: str, keep: Keep, take: Take) -> None:
        try:
            async with self._robot.listen(topic, keep=keep) as listening:
                while monotonic() - kept.asked_at < _IDLE_S:
                    for sample in await listening.take(_TURN_S):
                        await take(listening.type, sample)
        except RobotError as error:  # the next request subscribes again
            _logger.info("the costmap on %s is not kept: %s", topic, error)
            kept.error = error
        finally:
            kept.end()


def costmaps_of(robot: Robot) -> LastCostmaps:
    """Return the costmaps of a robot that are kept current."""
    return robot.kept.get(LastCostmaps, lambda: LastCostmaps(robot))


def sent_ns(sample: Sample) -> int:
    """Return when a message was sent; for a latched topic that is earlier than its receipt."""
    return sample.source_ns or sample.received_ns
