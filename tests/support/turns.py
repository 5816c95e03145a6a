"""Tests side by side, and times in which one of them must have the machine to itself."""

from __future__ import annotations

import fcntl
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO


class Turn:
    """A test's place among those of all processes that share the folder; while it is open, nobody else is alone."""

    def __init__(self, gate: IO[str], room: IO[str]) -> None:
        self._gate = gate
        self._room = room
        self._is_alone = False
        self._enter(fcntl.LOCK_SH)

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Waits until no other test runs, and lets none begin: those under way end first."""
        if self._is_alone:
            yield
            return
        fcntl.flock(self._room, fcntl.LOCK_UN)  # of two that want to be alone each would wait for the other
        self._enter(fcntl.LOCK_EX)
        self._is_alone = True
        try:
            yield
        finally:
            self._is_alone = False
            fcntl.flock(self._room, fcntl.LOCK_SH)

    def _enter(self, how: int) -> None:
        """Who waits to be alone keeps the gate shut, so that those who come later wait behind it."""
        fcntl.flock(self._gate, fcntl.LOCK_EX)
        fcntl.flock(self._room, how)
        fcntl.flock(self._gate, fcntl.LOCK_UN)


_turns: list[Turn] = []
"""Of the test that this process runs; none where it runs by itself."""


@contextmanager
def turn(folder: Path) -> Iterator[Turn]:
    """The turn of a test, as soon as no other is alone."""
    with (folder / "gate.lock").open("a") as gate, (folder / "room.lock").open("a") as room:
        _turns.append(Turn(gate, room))
        try:
            yield _turns[-1]
        finally:
            _turns.pop()


@contextmanager
def alone() -> Iterator[None]:
    """While the block lasts, no test of another worker runs; at once where there is none."""
    if not _turns:
        yield
        return
    with _turns[-1].alone():
        yield
