"""Watch a robot, and notify listeners of changes.

A subject is watched only while it has listeners: the first listener starts its watch, the last one to leave ends it. A
watch is shared by all clients that listen to its subject. So it is no job, which has one owner: it ends with its
listeners, and moves nothing.
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

# Seconds between notifications of a subject, so that a fast topic floods no client; changes in between count as one.
MIN_PERIOD_S = 0.2
# How long a client's answer waits for the subscription to begin: a topic may not exist yet.
BEGIN_S = 5.0
# Seconds before a failed watch is started again, longer with each failure in a row.
_PAUSES_S = (0.2, 0.5, 1.0, 2.0, 5.0)
_logger = logging.getLogger(__name__)

Changed = Callable[[], None]


class Subject(Protocol):
    """Something that changes. Equal subjects share one watch."""

    def changes(self, robot: Robot) -> AsyncGenerator[Any, None]:
        """Yield first the present state when the watch has begun (None if there is none), then a value for each change.

        The next value is requested up to `MIN_PERIOD_S` later: changes in between may be yielded as one. Errors of the
        link end the watch; it is then started again.
        """
        ...

    def __hash__(self) -> int: ...


class Watcher:
    """The watches of one robot."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._watches: dict[Subject, _Watch] = {}

    def watch(self, subject: Subject, changed: Changed) -> Callable[[], None]:
        """Call `changed` on every change of the subject from now on. Return a function that
        ends this, safe to call twice.

        `changed` must neither block nor raise.
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
        """Wait, at most `BEGIN_S`, until no later change of these subjects can be missed, or their watch has failed."""
        with anyio.move_on_after(BEGIN_S):
            for subject in subjects:
                if watch := self._watches.get(subject):
                    await watch.begun.wait()

    def newest(self, subject: Subject) -> Any:
        """Return the newest value of the subject's watch; None if there is no watch, or no value yet."""
        watch = self._watches.get(subject)
        return watch.newest if watch else None

    @property
    def watched(self) -> list[Subject]:
        """The subjects that have listeners now."""
        return list(self._watches)

    async def close(self) -> None:
        """End every watch and wait for its end."""
        tasks = [watch.task for watch in self._watches.values()]
        self._watches.clear()
        for task in tasks:
            task.cancel()
        if tasks:
            await asyncio.wait(tasks)


class _Watch:
    """One subject and its listeners. The watch continues after the bridge has been lost."""

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
                    if self.begun.is_set():  # started again: changes may have been missed, so this counts as one
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
