"""What the system tells of a process: its state, and its processor time, by which one that computes for too long is
ended, and not by the clock.

On a busy machine a process waits for its turn, and the clock goes on: a program that computes for 0.1 s may need 5 s.
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
"""CPUCLOCK_SCHED of Linux: the clock of what all threads of a process have used (clock_getcpuclockid(3))."""
_LOOK_S = 0.05
"""The shortest time between two looks: a process that has a millisecond left is not looked at every millisecond."""


def processor_s(pid: int) -> float:
    """The processor time that a process has used, in s. Where the system does not tell that of others, the clock.

    Raises:
        OSError: if there is no such process.
    """
    if sys.platform != "linux":
        return time.monotonic()
    return time.clock_gettime((~pid << 3) | _SCHEDULED)


def state_of(pid: int) -> str:
    """The state of a process, a letter as in proc_pid_stat(5); "" if there is none, "R" where only that is known."""
    if sys.platform != "linux":
        return "R" if _has_not_ended(pid) else ""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return ""


def _has_not_ended(pid: int) -> bool:
    system: Any = os  # macOS has `waitid` from Python 3.13 on, which its type stubs do not say
    if not hasattr(system, "waitid"):
        return True
    try:  # it is a child of this process; whoever began it waits for its end
        return system.waitid(system.P_PID, pid, system.WEXITED | system.WNOHANG | system.WNOWAIT) is None
    except OSError:
        return False


class ProcessorLimit:
    """Calls `exceed` once a process has computed for more than `turn_s` in one turn, or `all_s` in all of them (s).

    Only the turns count, which `turn` is told of. `exceeded` is then the limit that was too short.
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
        """The result of a step in which the process computes, until it waits for us again."""
        self._began = self._now()
        self._look_after(min(self._turn_s, self._all_s - self._used_s))
        try:
            return await step
        finally:
            self._timer.cancel()
            self._used_s += self._now() - self._began
            if self.exceeded is None and self._used_s >= self._all_s:  # no look falls into turns that are short
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
        """Its processor time; of a process that has ended nothing more is counted."""
        try:
            return processor_s(self._pid)
        except OSError:
            return self._began
