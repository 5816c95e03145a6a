"""Run long work in a thread, so that it does not block the event loop: the loop renews the link lease."""

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
"""Bytes of a message, or characters of JSON. Measured: the codec takes up to 5 ms for this size, the longest that a
thread may keep the interpreter from the event loop; for less, a thread costs more than it saves."""
_LEAST = 10
"""Characters that any JSON value counts for, with its separators: the time depends on the number of values, not of
digits."""
READING = "reading of messages"
"""The turn for parsing what clients send: separate from the turn of values, so that a stop does not wait behind
them."""
_turns = RunVar[dict[str, anyio.Semaphore]]("the turns of large work")
_loaded: set[str] = set()


async def aside(size: int, work: Callable[..., T], *args: Any, turn: str = "values") -> T:
    """Return `work(*args)`: run at once if its input is small, else in a thread, one at a time in each turn.

    One at a time, because each computing thread takes its share of the interpreter from the event loop. A cancelled
    caller stops waiting, but the turn ends only when the thread does; thus a caller cannot keep several threads busy.
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
    """Run large work without garbage collection.

    It creates a million objects and no reference cycles. Searching them for cycles would block all threads: for 100,000
    poses six times, for up to 0.15 s of processor time.
    """
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        return work(*args)
    finally:
        if was_enabled:
            gc.enable()


def extent(value: object) -> int:
    """Return about how many characters a value has as JSON; counting stops once it is large."""
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
    """Import, in a thread, modules that are needed only now: NumPy and the codec take 0.3 to 1 s."""
    missing = [name for name in modules if name not in _loaded]
    if missing:
        await to_thread.run_sync(_import, missing, abandon_on_cancel=True)


def _import(modules: list[str]) -> None:
    for name in modules:
        importlib.import_module(name)
        _loaded.add(name)
