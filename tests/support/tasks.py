"""Which tasks a test has running."""

from __future__ import annotations

import asyncio


def running_tasks() -> set[asyncio.Task[object]]:
    """The tasks of this loop that have not ended, without those of anyio's plugin, which carry fixtures and test."""
    return {task for task in asyncio.all_tasks() if not task.get_coro().__qualname__.startswith("TestRunner.")}
