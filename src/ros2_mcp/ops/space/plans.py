"""The plans that planners sent last: each is sent once, and not again to those who ask later."""

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
"""After the last question: a plan is sent once a second at most, so that hearing it costs next to nothing."""
_TURN_S = 5.0
"""Between two looks at whether it is still needed, where nothing comes."""
_SUBSCRIBED_S = 0.5
"""A subscription takes some milliseconds, over a network some hundred; what asks for plans is not to wait longer."""
_MOST = 6
"""Topics: a planner has one, its smoother another, and some publish goals."""
_logger = logging.getLogger(__name__)


class LastPlans(Kept):
    """The last message of some topics, as bytes, from the first question on until nobody has asked for a while."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._last: dict[str, tuple[str, Sample]] = {}
        self._work: dict[str, asyncio.Task[None]] = {}
        self._begun: dict[str, asyncio.Event] = {}
        self._since: dict[str, float] = {}
        self._asked_at = 0.0

    async def hear(self, topics: Sequence[str]) -> None:
        """Hears these topics from now on: the first few of those with a plan or goal in their names that are not sent
        all the time, as that of a controller is. Waits until they are subscribed, but not for long."""
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
        """The type and the last message of a topic; None if none was heard."""
        return self._last.get(topic)

    def heard_s(self, topic: str) -> float:
        """For how long it has been heard without a break; 0 while it is not."""
        return monotonic() - self._since[topic] if topic in self._since else 0.0

    async def _follow(self, topic: str) -> None:
        try:
            async with self._robot.listen(topic, keep="latest") as listening:
                self._begun[topic].set()
                self._since[topic] = monotonic()
                while monotonic() - self._asked_at < _IDLE_S:
                    for sample in await listening.take(_TURN_S):
                        self._last[topic] = listening.type, sample
        except RobotError as error:  # the next question begins anew
            _logger.info("the plans on %s are not kept: %s", topic, error)
        finally:
            self._since.pop(topic, None)
            self._begun[topic].set()

    async def close(self) -> None:
        """Ends listening."""
        for work in self._work.values():
            work.cancel()


def plans_of(robot: Robot) -> LastPlans:
    """The plans of a robot that are listened to."""
    return robot.kept.get(LastPlans, lambda: LastPlans(robot))


async def hear_plans(robot: Robot) -> None:
    """Keeps the plans that are sent from now on, for pictures that are asked for later."""
    with suppress(RobotError):
        await plans_of(robot).hear(await Live(robot).publishing(PATH))


async def sent_before(robot: Robot, topic: str, type_name: str) -> tuple[Next, float] | None:
    """The plan or goal of a topic that was heard last, and how many s ago; None if none was, or it was taken back."""
    if not (heard := plans_of(robot).last(topic)) or heard[0] != type_name:
        return None
    try:
        message: Any = (await robot.values.decode_all(type_name, [heard[1]]))[0]
    except RobotError:
        return None
    if type_name == PATH and not message.poses:
        return None
    return Next(message, heard[1], "", ""), max(robot.now_ns() - heard[1].received_ns, 0) / 1e9
