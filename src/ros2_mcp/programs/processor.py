"""The state and the processor time of a process.

A program that computes for too long is ended by its processor time, not by the clock: on a busy machine a process waits
for a processor while the clock runs, so that 0.1 s of computing may take 5 s.
"""

from __future__ import annotations

import asyncio
import os
import sys
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any, TypeVar

T = TypeVar("T")

_SCHEDULED = 2
"""CPUCLOCK_SCHED of Linux: the clock of the processor time of all threads of a process (clock_getcpuclockid(3))."""
_LOOK_S = 0.05
"""The shortest time between two checks, so that a process with a millisecond left is not checked every millisecond."""


def processor_s(pid: int) -> float:
    """Return the processor time that a process has used, in s. Except on Linux: the monotonic clock.

    Raises:
        OSError: if there is no such process.
    """
    if sys.platform != "linux":
        return time.monotonic()
    return time.clock_gettime((~pid << 3) | _SCHEDULED)


def state_of(pid: int) -> str:
    """Return the state of a process as a letter of proc_pid_stat(5); "" if it has ended. Except on Linux, only "R" or
    "".
    """
    if sys.platform != "linux":
        return "R" if _has_not_ended(pid) else ""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return ""


def _has_not_ended(pid: int) -> bool:
    system: Any = os  # macOS has `waitid` from Python 3.13 on, but not in its type stubs
    if not hasattr(system, "waitid"):
        return True
    try:  # it is a child of this process; the code that started it waits for its end
        return system.waitid(system.P_PID, pid, system.WEXITED | system.WNOHANG | system.WNOWAIT) is None
    except OSError:
        return False


class ProcessorLimit:
    """Calls `exceed` when a process has computed for more than `turn_s` in one turn, or `all_s` in all turns (s).

    Only computing during `turn` counts. `exceeded` is then the limit that was exceeded, in s; None before.
    """

    def __init__(self, pid: int, turn_s: float, all_s: float, exceed: Callable[[], None]) -> None:
        self._pid = pid
        self._turn_s = turn_s
        self._all_s = all_s
        self._exceed = exceed
        self._used_s = 0.0
        self._began = 0.0
        self.exceeded: float | None = None

    async def turn(self, step: Awaitable[T]) -> T:
        """Await a step in which the process computes until it waits for this server again. Return the result."""
        self._began = self._now()
        self._look_after(min(self._turn_s, self._all_s - self._used_s))
        try:
            return await step
        finally:
            self._timer.cancel()
            self._used_s += self._now() - self._began
            if self.exceeded is None and self._used_s >= self._all_s:  # short turns end before a check
                self.exceeded = self._all_s
                self._exceed()

    def _look_after(self, seconds: float) -> None:
        self._timer = asyncio.get_running_loop().call_later(max(seconds, _LOOK_S), self._look)

    def _look(self) -> None:
        used_s = self._now() - self._began
        left_s = min(self._turn_s - used_s, self._all_s - self._used_s - used_s)
        if left_s > 0:
            self._look_after(left_s)
            return
        self.exceeded = self._turn_s if used_s >= self._turn_s else self._all_s
        self._exceed()

    def _now(self) -> float:
        """Return the processor time of the process; if it has ended, the time at which the turn began."""
        try:
            return processor_s(self._pid)
        except OSError:
            return self._began
