"""The plans that planners sent last: each is sent once, and not again to those who ask later."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Sequence
from contextlib import AbstractAsyncContextManager
from time import monotonic

import anyio

from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.samples import Sample
from ros2_mcp.robot.listening import Listening

_IDLE_S = 600.0
"""After the last question: a plan is sent once a second at most, so that hearing it costs next to nothing."""
_TURN_S = 5.0
"""Between two looks at whether it is still needed, where nothing comes."""
_SUBSCRIBED_S = 0.5
"""A subscription takes some milliseconds, over a network some hundred; what asks for plans is not to wait longer."""
_MOST = 6
"""Topics: a planner has one, its smoother another, and some publish goals."""
_logger = logging.getLogger(__name__)

Listen = Callable[[str], AbstractAsyncContextManager[Listening]]


class LastPlans:
    """The last message of some topics, as bytes, from the first question on until nobody has asked for a while."""

    def __init__(self, listen: Listen) -> None:
        self._listen = listen
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
            async with self._listen(topic) as listening:
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
