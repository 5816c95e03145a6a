"""Times in which this machine stood still: what a test measures then is the machine and not the robot."""

from __future__ import annotations

import asyncio
import os
import threading
import time
from collections.abc import Awaitable, Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from typing import TypeVar

from support.turns import alone

STOOD_STILL_S = 0.1
TIMES = 5
LOOKS_S = 0.25
"""How often the processes under test are looked at: each time costs some milliseconds."""
STARVED_S = 0.15
"""Of that time; a process that begins waits for a shorter part of it on any machine with few processors."""

Measured = TypeVar("Measured")
Judged = Callable[[], AbstractContextManager[None]]
"""A context in which what happens is judged."""


@contextmanager
def standstills(shortest_s: float = STOOD_STILL_S, *, starved: bool = False) -> Iterator[list[tuple[float, float]]]:
    """From when to when, as Unix times, this process was not run although it wanted to, while the block runs.

    With `starved` also when a thread of the processes that it has begun waited for a processor most of the time.
    """
    found: list[tuple[float, float]] = []
    done = threading.Event()

    def look() -> None:
        before = looked_at = time.time()
        waited = _waited_ns() if starved else {}
        while not done.wait(shortest_s / 5):
            now = time.time()
            if now - before > shortest_s:
                found.append((before, now))
            if starved and now - looked_at > LOOKS_S:
                waited_until_now = _waited_ns()
                if any(ns - waited.get(each, ns) > STARVED_S * 1e9 for each, ns in waited_until_now.items()):
                    found.append((looked_at, now))
                waited, looked_at = waited_until_now, now
            before = now

    looking = threading.Thread(target=look, daemon=True)
    looking.start()
    try:
        yield found
    finally:
        done.set()
        looking.join()


def undisturbed(measure: Callable[[], Measured], shortest_s: float = STOOD_STILL_S) -> Measured:
    """What is measured while the machine does not stand still, of at most five measurements; else the last.

    Whether it is measured again depends on this witness alone, never on what was measured. After the first time no
    other test runs beside it: who is starved then is so by the test itself. `shortest_s` is the shortest standstill
    that would make a difference.
    """

    def whole(judged: Judged) -> Measured:
        with judged():
            return measure()

    return undisturbed_where_judged(whole, shortest_s)


def undisturbed_where_judged(measure: Callable[[Judged], Measured], shortest_s: float = STOOD_STILL_S) -> Measured:
    """As `undisturbed`, but only the time inside of `with judged():` counts, which `measure` enters once. Something
    that takes LOOKS_S should follow it, since a starvation is seen when it is looked for next.
    """
    measured, is_disturbed = _measured(measure, shortest_s, starved=True)
    if not is_disturbed:
        return measured
    with alone():
        for _ in range(TIMES - 1):
            measured, is_disturbed = _measured(measure, shortest_s, starved=False)
            if not is_disturbed:
                break
    return measured


def _measured(measure: Callable[[Judged], Measured], shortest_s: float, *, starved: bool) -> tuple[Measured, bool]:
    """What was measured, and whether the machine stood still in the time that counts."""
    began = ended = 0.0

    @contextmanager
    def judged() -> Iterator[None]:
        nonlocal began, ended
        began = time.time()
        yield
        ended = time.time()

    with standstills(shortest_s, starved=starved) as found:
        measured = measure(judged)
    return measured, any(since <= ended and until >= began for since, until in found)


async def undisturbed_async(measure: Callable[[], Awaitable[Measured]]) -> Measured:
    """As `undisturbed`."""
    with standstills(starved=True) as found:
        measured = await measure()
    if not found:
        return measured
    turn = alone()
    await asyncio.to_thread(turn.__enter__)  # what this loop keeps alive goes on meanwhile
    try:
        for _ in range(TIMES - 1):
            with standstills() as found:
                measured = await measure()
            if not found:
                break
    finally:
        turn.__exit__(None, None, None)
    return measured


def _waited_ns() -> dict[str, int]:
    """How long each thread of the processes that this one has begun has waited for a processor.

    From /proc/PID/task/TID/schedstat; see the kernel's Documentation/scheduler/sched-stats.rst.
    """
    waited: dict[str, int] = {}
    processes = list(_children(os.getpid()))
    while processes:
        process = processes.pop()
        for task in Path(f"/proc/{process}/task").glob("*"):
            with suppress(OSError, IndexError):  # it has ended, or this kernel does not count
                waited[f"{process}/{task.name}"] = int((task / "schedstat").read_text().split()[1])
        processes += _children(process)
    return waited


def _children(process: int) -> Iterator[int]:
    for task in Path(f"/proc/{process}/task").glob("*"):
        with suppress(OSError):  # it has ended
            yield from map(int, (task / "children").read_text().split())
