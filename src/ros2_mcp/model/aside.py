"""Work that takes long is done aside, in a thread: the event loop renews the link lease and is not to be held up."""

from __future__ import annotations

import asyncio
import gc
import importlib
from collections.abc import Callable, Mapping
from typing import Any, TypeVar, cast

import anyio
from anyio import to_thread
from anyio.lowlevel import RunVar

T = TypeVar("T")

LARGE = 20_000
"""Bytes of a message, or characters of JSON. Measured: the codec takes up to 5 ms for so much, as long as a thread may
keep the interpreter from the event loop; below that a thread costs more than it saves."""
_LEAST = 10
"""Characters that any value of JSON counts for, with what stands around it: the time goes by values, not by digits."""
READING = "reading of messages"
"""The turn of what clients send, so that a stop does not wait behind the values of others."""
_turns = RunVar[dict[str, anyio.Semaphore]]("the turns of large work")
_loaded: set[str] = set()


async def aside(size: int, work: Callable[..., T], *args: Any, turn: str = "values") -> T:
    """What `work(*args)` returns: done at once if what it works on is small, else in a thread, one after the other.

    One at a time in each turn, because each thread that computes takes the event loop its share. Who is cancelled
    waits no longer, but the turn ends only when the thread does: nobody can make it compute on for itself.
    """
    if size <= LARGE:
        return work(*args)
    turns = _turns.get(None)
    if turns is None:
        _turns.set(turns := {})
    taken = turns.setdefault(turn, anyio.Semaphore(1))
    await taken.acquire()
    return await asyncio.shield(asyncio.ensure_future(_until_done(taken, work, *args)))


async def _until_done(turn: anyio.Semaphore, work: Callable[..., T], *args: Any) -> T:
    try:
        return await to_thread.run_sync(_without_collecting, work, *args)
    finally:
        turn.release()


def _without_collecting(work: Callable[..., T], *args: Any) -> T:
    """Large work makes a million objects, and no garbage in circles. To look for that among them holds all threads up:
    for 100,000 poses six times, for up to 0.15 s of processor time.
    """
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        return work(*args)
    finally:
        if was_enabled:
            gc.enable()


def extent(value: object) -> int:
    """About how many characters a value is as JSON; of what is large no more is counted than that it is."""
    size, waiting = 0, [value]
    while waiting and size <= LARGE:
        one = waiting.pop()
        size += _LEAST
        if isinstance(one, (str, bytes)):
            size += len(one)
        elif isinstance(one, (int, float)) or one is None:
            continue
        elif isinstance(one, Mapping):
            waiting.extend(cast("Mapping[str, object]", one).values())
        elif isinstance(one, (list, tuple)):
            waiting.extend(cast("list[object]", one))
        else:
            size += getattr(one, "nbytes", 0)  # of an array
    return size


async def load(*modules: str) -> None:
    """Imports what is imported only when it is needed, in a thread: NumPy and the codec take 0.3 to 1 s."""
    missing = [name for name in modules if name not in _loaded]
    if missing:
        await to_thread.run_sync(_import, missing, abandon_on_cancel=True)


def _import(modules: list[str]) -> None:
    for name in modules:
        importlib.import_module(name)
        _loaded.add(name)
