"""What lets a stopper survive its bridge: a name of its own in the process list, and the kernel's protection.

A copy of a process has its command line, so that `pkill -f` ends both, and the out-of-memory killer and the swap treat
both alike. Everything here is done as far as the kernel allows it: without the rights the rest still holds.
"""

from __future__ import annotations

import ctypes
from contextlib import suppress
from pathlib import Path

# Of prctl(2) and mlockall(2).
_PR_SET_NAME = 15
_MCL_CURRENT, _MCL_ONFAULT = 1, 4
# Fields of proc_pid_stat(5) after the name of the process: the 48th and the 49th of all.
_ARG_START, _ARG_END = 45, 46
# From -1000 (never ended for want of memory) to 1000; less than what the process has needs CAP_SYS_RESOURCE, except
# down to the least that a process with that right had set for it. Chosen: a stopper that leaks is still ended.
_OOM_SCORES = (-900, 0)


def rename(name: str) -> None:
    """Show this name in place of the command line and of the program's name, in ps(1), pgrep(1) and the like."""
    with suppress(OSError, AttributeError, ValueError, IndexError):
        ctypes.CDLL(None).prctl(_PR_SET_NAME, name.encode(), 0, 0, 0)
        fields = Path("/proc/self/stat").read_text().rpartition(")")[2].split()
        start, end = int(fields[_ARG_START]), int(fields[_ARG_END])
        if start and end - start > 1:  # the last byte stays 0: else the kernel takes the environment for its rest
            shown = name.encode()[: end - start - 1]
            ctypes.memmove(start, shown.ljust(end - start, b"\0"), end - start)


def spare() -> None:
    """Be one of the last that are ended where memory is short."""
    for score in _OOM_SCORES:
        with suppress(OSError, ValueError):
            file = Path("/proc/self/oom_score_adj")
            if int(file.read_text()) > score:
                file.write_text(str(score))


def lock_memory() -> None:
    """Keep what this process has in memory from being swapped out, without loading more.

    What is mapped later is not locked: beyond its limit that would fail, and with it whoever asks for memory.
    """
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).mlockall(_MCL_CURRENT | _MCL_ONFAULT)
