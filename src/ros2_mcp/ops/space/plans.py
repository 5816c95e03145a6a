"""The latest plans of planners: each is published only once, so that a later subscriber does not receive it."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Sequence
from contextlib import suppress
from time import monotonic
from typing import Any

import anyio

from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.nav2 import PATH
from ros2_mcp.model.samples import Sample
from ros2_mcp.ops.pictures.next_message import Next
from ros2_mcp.ops.sources.live import Live
from ros2_mcp.robot import Robot
from ros2_mcp.robot.kept import Kept

_IDLE_S = 600.0
"""Time after the last request for which plans are still received: at most one a second is published, at little cost."""
_TURN_S = 5.0
"""Interval at which an idle subscription checks whether it is still needed."""
_SUBSCRIBED_S = 0.5
"""The longest wait for subscriptions: each takes milliseconds, over a network some hundred; the caller must not wait
longer."""
_MOST = 6
"""The most topics subscribed to: a planner has one topic, its smoother another, and some nodes publish goals."""
_logger = logging.getLogger(__name__)


class LastPlans(Kept):
    """The latest message of each plan or goal topic, as bytes. Subscriptions end after `_IDLE_S` without a request."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._last: dict[str, tuple[str, Sample]] = {}
        self._work: dict[str, asyncio.Task[None]] = {}
        self._begun: dict[str, asyncio.Event] = {}
        self._since: dict[str, float] = {}
        self._asked_at = 0.0

    async def hear(self, topics: Sequence[str]) -> None:
        """Subscribe to the plan and goal topics among `topics`, at most six, without the topics of local planners,
        where messages come all the time. Wait for the subscriptions, at most `_SUBSCRIBED_S`.
        """
        self._asked_at = monotonic()
        lasts = {name: name.rpartition("/")[2] for name in topics if "local" not in name}
        wanted = [name for name, last in lasts.items() if "plan" in last or "goal" in last]
        for topic in wanted:
            work = self._work.get(topic)
            if (work is None or work.done()) and (topic in self._work or len(self._work) < _MOST):
                self._begun[topic] = asyncio.Event()
                self._work[topic] = asyncio.create_task(self._follow(topic))
        with anyio.move_on_after(_SUBSCRIBED_S):
            for topic in wanted:
                if topic in self._begun:
                    await self._begun[topic].wait()

    def last(self, topic: str) -> tuple[str, Sample] | None:
        """Return the type and the latest message of a topic; None if none was received."""
        return self._last.get(topic)

    def heard_s(self, topic: str) -> float:
        """Return for how many s the topic has been subscribed to without interruption; 0 if it is not subscribed to."""
        return monotonic() - self._since[topic] if topic in self._since else 0.0

    async def _follow(self, topic: str) -> None:
        try:
            async with self._robot.listen(topic, keep="latest") as listening:
                self._begun[topic].set()
                self._since[topic] = monotonic()
                while monotonic() - self._asked_at < _IDLE_S:
                    for sample in await listening.take(_TURN_S):
                        self._last[topic] = listening.type, sample
        except RobotError as error:  # the next request subscribes again
            _logger.info("the plans on %s are not kept: %s", topic, error)
        finally:
            self._since.pop(topic, None)
            self._begun[topic].set()

    async def close(self) -> None:
        """End all subscriptions."""
        for work in self._work.values():
            work.cancel()


def plans_of(robot: Robot) -> LastPlans:
    """Return the kept plans of a robot."""
    return robot.kept.get(LastPlans, lambda: LastPlans(robot))


async def hear_plans(robot: Robot) -> None:
    """Receive plans from now on, for pictures that are requested later."""
    with suppress(RobotError):
        await plans_of(robot).hear(await Live(robot).publishing(PATH))


async def sent_before(robot: Robot, topic: str, type_name: str) -> tuple[Next, float] | None:
    """Return the latest plan or goal received on a topic and its age in s; None if none was received, or the planner
    withdrew it by an empty path.
    """
    if not (heard := plans_of(robot).last(topic)) or heard[0] != type_name:
        return None
    try:
        message: Any = (await robot.values.decode_all(type_name, [heard[1]]))[0]
    except RobotError:
        return None
    if type_name == PATH and not message.poses:
        return None
    return Next(message, heard[1], "", ""), max(robot.now_ns() - heard[1].received_ns, 0) / 1e9
