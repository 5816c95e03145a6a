"""The latch: while it is set, nothing acts on this robot. Only an operator resets it. It is one small file.

It is a file because it has to outlive processes: after a restart, for a second server, or if the stopper sets it
because server and bridge have died. Server, bridge and stopper read and write it with this module. A look costs one
`stat`, so that every exit can look each time. See docs/decisions/0029-latch-and-state.md.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import secrets
import sys
import threading
import time
from collections.abc import Callable, Generator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, cast

from ros2_mcp_common.files import PLAIN, take_lock
from ros2_mcp_common.files import replace as put_in_place

FILE = "latch.json"
# Processes write in turns, each as long as the disk takes, normally milliseconds. A process that hangs in its turn must
# not keep a stop from being latched: after this time the latch is set without a turn; a reset gives up.
TURN_S = 1.0
_TURN_POLL_S = 0.002
# The period of further tries if the latch cannot be written, for example to a full disk. An operator resets what is in
# the file.
WRITTEN_AGAIN_S = 2.0
# So many files written one after the other have different sizes: more than can be written in one clock tick.
_SIZES = 61
# A process that writes without a turn skips a random number of counts below this. Otherwise two such processes, each
# not knowing of the other, would use the same count, and an operator who looked at one would also reset the other.
_SKIPPED = 1_000_000
# The longest name or reason in characters, so that a caller cannot fill the disk.
MAX_TEXT = 500


@dataclass(frozen=True)
class LatchState:
    """Whether the latch is set, by whom and why, and since when (Unix time, s).

    `count` grows with each setting. A command accepted at another count does not act any more, also after a reset.
    While the latch is set, the first cause is kept; `count` shows whether another one came since an operator looked.
    """

    is_set: bool = False
    count: int = 0
    by: str = ""
    reason: str = ""
    since: float = 0.0


_KINDS: Mapping[str, Any] = {"is_set": bool, "count": int, "by": str, "reason": str, "since": (int, float)}
"""The JSON types of the file's entries; others are rejected, because they could not be sent or shown."""


class ResetRefused(Exception):
    """Raised if a reset was not carried out; its text says why."""


class Latch:
    """The latch in a file; without a path it is kept in memory only. Thread-safe.

    A latch that cannot be read counts as set. If the file vanishes, the last state that was read holds.

    If the file is on another machine, a latch in memory mirrors it: `mirror` gives it the state there.
    """

    def __init__(self, path: Path | None = None) -> None:
        self.path = path
        self._turn = threading.Lock()
        self._seen: tuple[int, int, int] | None = None
        self._state = LatchState()
        self._held: LatchState | None = None
        self._mirrored = LatchState()
        self.is_own = False
        """Whether it was set here, in memory, and the latch that it mirrors does not have that setting yet."""

    def look(self) -> LatchState:
        """Return the current state; never raises."""
        written, held = self._read(), self._held
        return held if held and not written.is_set else written

    def set(self, *, by: str, reason: str) -> str:
        """Set the latch, for this process at once. Return why it could not be written, "" if it was written."""
        self.hold(by=by, reason=reason)
        return self.write()

    def hold(self, *, by: str, reason: str) -> None:
        """Set the latch for this process, at once. `write` makes it permanent, and may take as long as the disk."""
        state = self.look()
        self.is_own = self.path is None
        cause = {} if state.is_set else {"by": by[:MAX_TEXT], "reason": reason[:MAX_TEXT], "since": time.time()}
        self._held = replace(state, is_set=True, count=state.count + 1, **cause)

    def write(self) -> str:
        """Write a setting that is held in memory. Return why it could not be written, "" if it was written."""
        held = self._held
        if held is None:
            return ""
        if self.path is None:
            self._state = held
        else:
            try:
                with self._turn, _turn(self.path, is_needed=False) as has_turn:
                    self._write(self._after(held, 1 if has_turn else 2 + secrets.randbelow(_SKIPPED)))
            except OSError as error:
                sys.stderr.write(f"the latch could not be written: {error}\n")
                return str(error)
        if self._held is held:
            self._held = None
        return ""

    def mirror(self, state: LatchState) -> None:
        """Take over a changed state of the latch on another machine; only for a latch without a path.

        A setting from here is not reset until it was set there, too. The count grows by as many
        settings as there were there.
        """
        with self._turn:
            before = self._mirrored
            if self.path is not None or (self.is_own and not state.is_set):
                return
            self.is_own, self._mirrored = False, state
            if state == before:
                return
            # The first state may be of a latch that was set and reset often, long before this one existed.
            grown = max(state.count - before.count, 0) if before.count else int(state.is_set)
            grown = max(grown, int(state.is_set and not before.is_set))
            self._state, self._held = replace(state, count=self._state.count + grown), None

    def write_at_last(self) -> None:
        """Write a setting that is held in memory, trying again until that succeeds or an operator has reset it."""
        while self.write():
            time.sleep(WRITTEN_AGAIN_S)

    def reset(self, *, by: str, seen: int) -> LatchState:
        """Reset the latch for an operator who looked at it when its count was `seen`. Return the new state.

        Nothing that was stopped starts again.

        Raises:
            ResetRefused: if it was set again since, or cannot be written.
        """
        try:
            with self._turn, _turn(self.path, is_needed=True) if self.path else contextlib.nullcontext():
                state = LatchState(False, seen, by[:MAX_TEXT], "reset", time.time())
                self._check_unchanged(seen)
                if self.path:
                    self._write(state, lambda: self._check_unchanged(seen))
                self._state, self._held = state, None
                return state
        except OSError as error:
            raise ResetRefused(f"it cannot be written: {error}") from error

    def _read(self) -> LatchState:
        if self.path is None:
            return self._state
        try:
            found = self.path.stat()
        except FileNotFoundError:
            return self._state
        except OSError as error:
            return self._unreadable(error)
        # Each change replaces the file. Within one tick of the file system's clock (4 ms) an inode number may be used
        # again: `_write` makes the size differ then.
        seen = found.st_ino, found.st_mtime_ns, found.st_size
        if seen != self._seen:
            try:
                self._state, self._seen = _from_json(self.path.read_bytes()), seen
            except (OSError, ValueError) as error:
                return self._unreadable(error)
        return self._state

    def _check_unchanged(self, seen: int) -> None:
        self._seen = None  # the file itself decides
        now = self.look()
        if now.count != seen:
            raise ResetRefused(f"it was set again since you looked: {now.by}: {now.reason}")

    def _after(self, state: LatchState, step: int) -> LatchState:
        """Return the state to write after what another process may have written meanwhile.

        The cause in the file is kept, and the count grows.
        """
        assert self.path
        try:
            written = _from_json(self.path.read_bytes())
        except (OSError, ValueError):
            return replace(state, count=state.count - 1 + step)
        count = max(state.count - 1, written.count) + step
        return replace(written if written.is_set else state, count=count)

    def _unreadable(self, error: Exception) -> LatchState:
        self._seen = None
        self._state = replace(self._state, is_set=True, by="ros2-mcp", reason=f"the latch cannot be read: {error}")
        return self._state

    def _write(self, state: LatchState, check: Callable[[], None] = lambda: None) -> None:
        """Replace the file, and sync it to the disk, because a robot may be switched off.

        `check` is called directly before.
        """
        assert self.path
        written = self.path.with_name(f".{self.path.name}.{os.getpid()}.{threading.get_ident()}")
        descriptor = os.open(written, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | PLAIN, 0o600)
        with os.fdopen(descriptor, "w") as file:
            file.write(json.dumps(asdict(state)) + " " * (state.count % _SIZES))
            file.flush()
            os.fsync(file.fileno())
        check()
        put_in_place(written, self.path)
        self._state = state


@contextlib.contextmanager
def _turn(path: Path, *, is_needed: bool) -> Generator[bool, None, None]:
    """A context manager around reading and writing: only one process at a time is in it.

    The context's value is True, or False for a caller that does not need a turn and got none within `TURN_S`.
    """
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    descriptor = os.open(path.with_suffix(".lock"), os.O_RDWR | os.O_CREAT | PLAIN, 0o600)
    try:
        deadline = time.monotonic() + TURN_S
        while not (has_turn := take_lock(descriptor)):
            if time.monotonic() >= deadline:
                if is_needed:
                    raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))
                break
            time.sleep(_TURN_POLL_S)
        yield has_turn
    finally:
        os.close(descriptor)


def _from_json(text: bytes) -> LatchState:
    """Return the state in the file's text. Raise `ValueError` if it is no latch."""
    found: Any = json.loads(text)
    if not isinstance(found, Mapping):
        raise ValueError("it is no JSON object")
    fields = cast("Mapping[str, Any]", found)
    for name, kind in _KINDS.items():
        if not isinstance(fields.get(name), kind):
            raise ValueError(f"its {name} is {fields.get(name)!r}")
    return LatchState(**{name: fields[name] for name in _KINDS})
