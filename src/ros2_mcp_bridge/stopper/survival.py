"""Measures that let a stopper survive its bridge: its own name in the process list, and protection by the kernel.

A forked process has the command line of its parent, so `pkill -f` would end both, and the out-of-memory killer and
swapping would treat both alike. Each function does as much as the kernel permits; without the rights, the others still
work.
"""

from __future__ import annotations

import ctypes
from contextlib import suppress
from pathlib import Path

# Constants of prctl(2) and mlockall(2).
_PR_SET_NAME = 15
_MCL_CURRENT, _MCL_ONFAULT = 1, 4
# Indices into the fields of proc_pid_stat(5) that follow the name of the process: fields 48 and 49 of the whole line.
_ARG_START, _ARG_END = 45, 46
# Values of oom_score_adj to try, from -1000 (never killed) to 1000. Lowering it needs CAP_SYS_RESOURCE, except down to
# the lowest value that a process with that right has set for this one. -900 rather than -1000, so that a leaking
# stopper can still be killed.
_OOM_SCORES = (-900, 0)


def rename(name: str) -> None:
    """Show this name instead of the command line and the program's name in ps(1), pgrep(1) and the like."""
    with suppress(OSError, AttributeError, ValueError, IndexError):
        ctypes.CDLL(None).prctl(_PR_SET_NAME, name.encode(), 0, 0, 0)
        fields = Path("/proc/self/stat").read_text().rpartition(")")[2].split()
        start, end = int(fields[_ARG_START]), int(fields[_ARG_END])
        if start and end - start > 1:  # the last byte stays 0: otherwise the kernel appends the environment
            shown = name.encode()[: end - start - 1]
            ctypes.memmove(start, shown.ljust(end - start, b"\0"), end - start)


def spare() -> None:
    """Make this process one of the last that the out-of-memory killer chooses."""
    for score in _OOM_SCORES:
        with suppress(OSError, ValueError):
            file = Path("/proc/self/oom_score_adj")
            if int(file.read_text()) > score:
                file.write_text(str(score))


def lock_memory() -> None:
    """Keep the current memory of this process from being swapped out, without loading more of it.

    Memory mapped later is not locked: beyond the limit of locked memory, allocations would fail.
    """
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).mlockall(_MCL_CURRENT | _MCL_ONFAULT)
