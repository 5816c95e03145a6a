"""Runs each scenario in an event loop of its own, and fails it if it leaves a task behind."""

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any

import pytest


@pytest.fixture
def play() -> Callable[[Coroutine[Any, Any, None]], None]:
    def run(scenario: Coroutine[Any, Any, None]) -> None:
        async def watched() -> None:
            await asyncio.wait_for(scenario, 60)
            for _ in range(100):
                await asyncio.sleep(0.01)
                left = asyncio.all_tasks() - {asyncio.current_task()}
                if not left:
                    break
            assert not left, left

        asyncio.run(watched())

    return run
