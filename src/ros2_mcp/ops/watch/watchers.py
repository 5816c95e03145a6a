"""Watching a robot for those who want to be told of changes.

Nothing is watched while nobody listens: the first listener of a subject starts its watch, the last one to leave ends
it. A watch is shared by all clients that listen to its subject, so it is no job, which has one owner: it ends with
them, and moves nothing.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncGenerator, Callable
from contextlib import aclosing
from typing import Any, Protocol

import anyio

from ros2_mcp.model.errors import LinkError, RobotError
from ros2_mcp.robot import Robot

# Between two notifications of one subject, so that a fast topic floods no client; changes in between count as one.
MIN_PERIOD_S = 0.2
# How long a subscription is waited for before a client gets its answer all the same: a topic may not be there yet.
BEGIN_S = 5.0
# Before a watch that failed is begun again, longer with each failure in a row.
_PAUSES_S = (0.2, 0.5, 1.0, 2.0, 5.0)
_logger = logging.getLogger(__name__)

Changed = Callable[[], None]


class Subject(Protocol):
    """Something that changes. Equal subjects share one watch."""

    def changes(self, robot: Robot) -> AsyncGenerator[Any, None]:
        """Yields first what is there when the watch has begun (None if nothing), then something for each change.

        The next value is asked for up to `MIN_PERIOD_S` later: changes in between may be yielded as one. Errors of the
        link end it; it is then begun again.
        """
        ...

    def __hash__(self) -> int: ...


class Watcher:
    """The watches of one robot."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._watches: dict[Subject, _Watch] = {}

    def watch(self, subject: Subject, changed: Changed) -> Callable[[], None]:
        """Calls `changed` on every change of the subject from now on; returns what ends that, safe to call twice.

        `changed` must neither wait nor raise.
        """
        watch = self._watches.get(subject)
        if watch is None:
            watch = self._watches[subject] = _Watch(self._robot, subject)
        token = object()
        watch.listeners[token] = changed

        def leave() -> None:
            watch.listeners.pop(token, None)
            if not watch.listeners and self._watches.get(subject) is watch:
                del self._watches[subject]
                watch.task.cancel()

        return leave

    async def begun(self, *subjects: Subject) -> None:
        """Waits (bounded) until nothing that happens to the watched subjects from now on is missed, or one failed."""
        with anyio.move_on_after(BEGIN_S):
            for subject in subjects:
                if watch := self._watches.get(subject):
                    await watch.begun.wait()

    def newest(self, subject: Subject) -> Any:
        """What the watch of the subject saw last; None if there is none, or it has not seen anything."""
        watch = self._watches.get(subject)
        return watch.newest if watch else None

    @property
    def watched(self) -> list[Subject]:
        """What somebody listens to now."""
        return list(self._watches)

    async def close(self) -> None:
        """Ends every watch and waits for its end."""
        tasks = [watch.task for watch in self._watches.values()]
        self._watches.clear()
        for task in tasks:
            task.cancel()
        if tasks:
            await asyncio.wait(tasks)


class _Watch:
    """One subject with those who listen to it; goes on when the bridge has been lost."""

    def __init__(self, robot: Robot, subject: Subject) -> None:
        self.listeners: dict[object, Changed] = {}
        self.newest: Any = None
        self.begun = asyncio.Event()
        self._robot, self._subject = robot, subject
        self.task = asyncio.create_task(self._run())

    async def _run(self) -> None:
        failures = 0
        while True:
            try:
                async with aclosing(self._subject.changes(self._robot)) as changes:
                    self.newest = await anext(changes)
                    failures = 0
                    if self.begun.is_set():  # begun again: nobody knows what was missed, so that is a change
                        self._notify()
                    self.begun.set()
                    async for self.newest in changes:
                        self._notify()
                        await asyncio.sleep(MIN_PERIOD_S)
            except RobotError as error:
                level = logging.INFO if isinstance(error, LinkError) else logging.WARNING
                _logger.log(level, "watching %s: %s", self._subject, error)
                self.begun.set()
            failures += 1
            await asyncio.sleep(_PAUSES_S[min(failures, len(_PAUSES_S)) - 1])

    def _notify(self) -> None:
        for changed in list(self.listeners.values()):
            changed()
