"""The watcher's bookkeeping, on a subject that changes on command."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, AsyncIterator
from itertools import pairwise
from typing import Any, cast

import pytest

from ros2_mcp.model.errors import BridgeLost
from ros2_mcp.ops.watch.watchers import MIN_PERIOD_S, Watcher
from ros2_mcp.robot import Robot
from support.tasks import running_tasks, soon

NO_ROBOT = cast(Robot, None)


class Bell:
    """A subject that changes whenever it is rung, and counts its lives."""

    def __init__(self) -> None:
        self.begun = self.ended = 0
        self.rings: asyncio.Queue[Any] = asyncio.Queue()

    async def changes(self, robot: Robot) -> AsyncGenerator[Any, None]:
        assert robot is NO_ROBOT
        self.begun += 1
        try:
            yield "begun"
            while True:
                ring = await self.rings.get()
                if isinstance(ring, Exception):
                    raise ring
                yield ring
        finally:
            self.ended += 1


@pytest.fixture
def bell() -> Bell:
    return Bell()


@pytest.fixture
async def watcher(bell: Bell) -> AsyncIterator[Watcher]:
    """Closed after the test: then it must have no task left, and the bell must have ended as often as it began."""
    before = running_tasks()
    watcher = Watcher(NO_ROBOT)
    yield watcher
    await watcher.close()
    assert running_tasks() == before
    assert bell.begun == bell.ended


async def test_a_change_is_told_to_everybody_who_listens(watcher: Watcher, bell: Bell) -> None:
    told: list[str] = []
    leave = watcher.watch(bell, lambda: told.append("a"))
    watcher.watch(bell, lambda: told.append("b"))
    await watcher.begun(bell)
    assert told == []
    bell.rings.put_nowait(1)
    await soon(lambda: told == ["a", "b"])
    leave()
    bell.rings.put_nowait(2)
    await soon(lambda: told == ["a", "b", "b"])
    assert watcher.newest(bell) == 2
    assert bell.begun == 1


async def test_the_last_one_to_leave_ends_the_watch_and_a_new_one_begins_it_again(watcher: Watcher, bell: Bell) -> None:
    for _ in range(100):
        leave = watcher.watch(bell, lambda: None)
        await watcher.begun(bell)
        leave()
        leave()
        assert watcher.watched == []
    await soon(lambda: bell.ended == 100)


async def test_many_changes_are_told_at_most_five_times_a_second(watcher: Watcher, bell: Bell) -> None:
    moments: list[float] = []
    watcher.watch(bell, lambda: moments.append(asyncio.get_running_loop().time()))
    await watcher.begun(bell)
    for number in range(4):
        bell.rings.put_nowait(number)
    await soon(lambda: len(moments) == 4)
    gaps = [later - earlier for earlier, later in pairwise(moments)]
    assert min(gaps) >= MIN_PERIOD_S * 0.95


async def test_after_a_lost_bridge_the_watch_goes_on_and_tells_that_something_may_have_changed(
    watcher: Watcher, bell: Bell
) -> None:
    told: list[str] = []
    watcher.watch(bell, lambda: told.append("changed"))
    await watcher.begun(bell)
    bell.rings.put_nowait(BridgeLost("gone"))
    await soon(lambda: bell.begun == 2 and told == ["changed"])
