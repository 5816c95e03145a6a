"""The newest messages, as bytes, of topics that are read repeatedly: each topic is subscribed to once."""

from __future__ import annotations

import asyncio
import logging
from dataclasses import dataclass, field
from time import monotonic

import anyio

from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.samples import Sample
from ros2_mcp.robot import Robot
from ros2_mcp.robot.kept import Kept
from ros2_mcp.robot.listening import Listening

_IDLE_S = 5.0
"""How long a subscription stays after the last read: readers read several times a second, and a page
that was closed must cost nothing."""
_TURN_S = 1.0
"""Seconds between two checks of whether a subscription is still needed, if no message arrives."""
_AGAIN_S = 2.0
"""Seconds before a failed subscription is tried again: the publisher may be starting."""
_FITS_S = 3.0
"""Seconds between two checks of whether another QoS fits the publishers now. Each costs the bridge a millisecond."""
_RATE_S = 3.0
"""The time over which a rate is measured: short enough to show a drop, long enough for a topic of 1 Hz."""
_logger = logging.getLogger(__name__)


@dataclass(eq=False)
class Newest:
    """The newest message of one topic. `since` is when it was first read (monotonic, s); `error` is why there is no
    subscription. `opened_ns` is when the subscription began, by the robot's clock, if the topic is latched, else 0.
    """

    topic: str
    since: float = field(default_factory=monotonic)
    listening: Listening | None = None
    sample: Sample | None = None
    error: RobotError | None = None
    opened_ns: int = 0
    came: asyncio.Event = field(default_factory=asyncio.Event)
    task: asyncio.Task[None] | None = None
    looked_at: float = 0.0
    counted: list[tuple[float, int]] = field(default_factory=list[tuple[float, int]])

    async def newer(self, than: Sample | None, timeout_s: float) -> Sample | None:
        """Return a sample other than `than`, as soon as it is there; None if no such sample came in time."""
        self.looked_at = monotonic()
        deadline = monotonic() + timeout_s
        while self.sample is None or self.sample is than:
            with anyio.move_on_after(max(deadline - monotonic(), 0.0)) as scope:
                await self.came.wait()
            if scope.cancelled_caught:
                return None
        return self.sample

    def rate_hz(self) -> float | None:
        """Return the messages per second of the last `_RATE_S`; None before that is known."""
        if self.listening is None:
            return None
        now, received = monotonic(), self.listening.counts.received
        self.counted = [one for one in self.counted if now - one[0] <= _RATE_S]
        self.counted.append((now, received))
        began, first = self.counted[0]
        return (received - first) / (now - began) if now - began > _RATE_S / 2 else None

    def tell(self) -> None:
        """Wake all tasks that wait for a message."""
        came, self.came = self.came, asyncio.Event()
        came.set()


class NewestSamples(Kept):
    """The newest message of each topic, subscribed from the first read until `_IDLE_S` after the last read."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._topics: dict[str, Newest] = {}

    def of(self, topic: str) -> Newest:
        """Return the newest message of a topic, and subscribe to it from now on."""
        newest = self._topics.get(topic)
        if newest is None or newest.task is None or newest.task.done():
            newest = self._topics[topic] = Newest(topic)
            newest.task = asyncio.create_task(self._follow(newest))
        newest.looked_at = monotonic()
        return newest

    async def close(self) -> None:
        """End all subscriptions."""
        tasks = [newest.task for newest in self._topics.values() if newest.task]
        self._topics.clear()
        for task in tasks:
            task.cancel()
        if tasks:
            await asyncio.wait(tasks)

    async def _follow(self, newest: Newest) -> None:
        while monotonic() - newest.looked_at < _IDLE_S:
            try:
                async with self._robot.listen(newest.topic, keep="latest") as listening:
                    newest.listening, newest.error, newest.counted = listening, None, []
                    is_latched = listening.choice.qos.durability == "transient_local"
                    newest.opened_ns = listening.opened_ns if is_latched else 0
                    await self._take(newest, listening)
            except RobotError as error:
                newest.error = error
                _logger.info("%s is not shown: %s", newest.topic, error)
                newest.tell()
                await asyncio.sleep(_AGAIN_S)
            finally:
                newest.listening = None
        if self._topics.get(newest.topic) is newest:
            del self._topics[newest.topic]

    async def _take(self, newest: Newest, listening: Listening) -> None:
        """Take messages until the topic is no longer read, or another QoS is needed."""
        looked_at = monotonic()
        while monotonic() - newest.looked_at < _IDLE_S:
            if samples := await listening.take(_TURN_S):
                newest.sample = samples[-1]
                newest.tell()
            if monotonic() - looked_at > _FITS_S:
                looked_at = monotonic()
                if not listening.still_fits(await self._robot.graph.endpoints(listening.topic)):
                    return


def newest_of(robot: Robot, topic: str) -> Newest:
    """Return the newest message of a topic of a robot, which is subscribed to from now on."""
    return robot.kept.get(NewestSamples, lambda: NewestSamples(robot)).of(topic)
