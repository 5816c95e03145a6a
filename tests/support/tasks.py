"""Tasks of a test: which are running, and waiting for what they do."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

PATIENCE_S = 20.0
"""For what takes no time on a machine that is not held up."""


def running_tasks() -> set[asyncio.Task[object]]:
    """The tasks of this loop that have not ended, without those of anyio's plugin, which carry fixtures and test."""
    names = {task: getattr(task.get_coro(), "__qualname__", "") for task in asyncio.all_tasks()}
    return {task for task, name in names.items() if not name.startswith("TestRunner.")}


async def soon(condition: Callable[[], bool]) -> None:
    """Waits until the condition holds, at most 20 s."""
    deadline = time.monotonic() + PATIENCE_S
    while not condition() and time.monotonic() < deadline:
        await asyncio.sleep(0.005)
    assert condition()
