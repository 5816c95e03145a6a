"""The signals that end a process, on every system."""

from __future__ import annotations

import asyncio
import signal
import sys
from collections.abc import Callable

if sys.platform == "win32":
    TOLD_TO_END = (signal.SIGINT, signal.SIGTERM, signal.SIGBREAK)
else:
    TOLD_TO_END = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Ctrl+C, termination by another process, and the end of the terminal (on Windows Ctrl+Break)."""


def when_told_to_end(do: Callable[[], object]) -> None:
    """Make these signals call `do` in the running event loop from now on, instead of ending the process."""
    loop = asyncio.get_running_loop()

    def told(*_: object) -> None:
        loop.call_soon_threadsafe(do)

    for number in TOLD_TO_END:
        if sys.platform == "win32":  # its event loop does not support signals
            signal.signal(number, told)
        elif number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:  # ignored: run by nohup
            loop.add_signal_handler(number, do)
