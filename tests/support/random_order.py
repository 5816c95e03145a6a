"""An event loop that runs what is ready in a random order, as no code may rely on the order of tasks."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable
from contextvars import Context
from typing import Any

MOST_S = 1e-4
"""By how much what is ready may be put off: enough for the others of its turn to come first."""


class RandomOrder(asyncio.SelectorEventLoop):
    """Whatever is to run soon runs soon, but not in the order in which it became ready."""

    def __init__(self, seed: int) -> None:
        super().__init__()
        self._random = random.Random(seed)

    def call_soon(self, callback: Callable[..., Any], *args: Any, context: Context | None = None) -> asyncio.Handle:  # type: ignore[override]
        return self.call_at(self.time() + self._random.uniform(0.0, MOST_S), callback, *args, context=context)
