"""Times in which this machine stood still: what a test measures then is the machine and not the robot."""

from __future__ import annotations

import threading
import time
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

STOOD_STILL_S = 0.1
TIMES = 5
_LOOK_S = 0.02

Measured = TypeVar("Measured")


@contextmanager
def standstills() -> Iterator[list[tuple[float, float]]]:
    """From when to when, as Unix times, this process was not run although it wanted to, while the block runs."""
    found: list[tuple[float, float]] = []
    done = threading.Event()

    def look() -> None:
        before = time.time()
        while not done.wait(_LOOK_S):
            now = time.time()
            if now - before > STOOD_STILL_S:
                found.append((before, now))
            before = now

    looking = threading.Thread(target=look, daemon=True)
    looking.start()
    try:
        yield found
    finally:
        done.set()
        looking.join()


def undisturbed(measure: Callable[[], Measured]) -> Measured:
    """What is measured while the machine does not stand still, of at most five measurements; else the last.

    Whether it is measured again depends on this witness alone, never on what was measured.
    """
    for _ in range(TIMES - 1):
        with standstills() as found:
            measured = measure()
        if not found:
            return measured
    return measure()


async def undisturbed_async(measure: Callable[[], Awaitable[Measured]]) -> Measured:
    """As `undisturbed`."""
    for _ in range(TIMES - 1):
        with standstills() as found:
            measured = await measure()
        if not found:
            return measured
    return await measure()
