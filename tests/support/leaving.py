"""A peer that is told to end leaves as a ROS node should, and ends whatever becomes of that.

Fast DDS 2.14 hangs in about one of some hundred ends, where others leave at the same time, and holds the interpreter's
lock meanwhile: no thread and no handler of Python can end such a process (docs/known-races.md).
"""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable

LEAVES_S = 5.0
"""A node leaves within a second; a busy machine stretches that. Half of what the tests wait for a process."""


def leave_on_sigterm(leave: Callable[[], object] = sys.exit) -> None:
    """From now on SIGTERM calls `leave`, and the kernel ends this process (SIGALRM) if it is still there after that."""
    signal.signal(signal.SIGALRM, signal.SIG_DFL)

    def end(*_: object) -> None:
        signal.setitimer(signal.ITIMER_REAL, LEAVES_S)
        leave()

    signal.signal(signal.SIGTERM, end)
