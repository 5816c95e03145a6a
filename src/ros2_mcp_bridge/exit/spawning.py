"""Starting the stopper processes, each in a session of its own, so that a signal to the
bridge's session spares them.
"""

from __future__ import annotations

import fcntl
import os
import re
import signal
import sys
import termios
import warnings
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

STOPPER_ARGUMENT = "--stopper"
STOPPERS = ("robot-stopper", "motion-standby")
"""The names of the two stoppers in the process list.

No pattern that matches the bridge or the server matches one of them.
"""
# A forked process closes descriptors up to this number, because they would keep the stream to the server open. More
# than a process has.
MOST_DESCRIPTORS = 65536
_FILE_IN_MEMORY = re.match(r"/(?:proc/self|dev)/fd/(\d+)/", __file__)
ARCHIVE = int(_FILE_IN_MEMORY[1]) if _FILE_IN_MEMORY else MOST_DESCRIPTORS
"""The descriptor of the zip from which a bridge started by stage1.py is imported; a child needs it, too."""


class Child(NamedTuple):
    """A child process, the writing end of its stdin (`lifeline`), and the reading end of its stdout (`told`)."""

    pid: int
    lifeline: int
    told: int

    def has_ended(self) -> bool:
        """Return whether the process has ended, and reap it if so."""
        with suppress(ChildProcessError):  # it was reaped before
            return os.waitpid(self.pid, os.WNOHANG)[0] != 0
        return True

    def has_unread(self) -> bool:
        """Return whether the process has not yet read everything from its stdin."""
        return any(fcntl.ioctl(self.lifeline, termios.FIONREAD, bytes(4)))

    def kill(self) -> None:
        """Kill the process with SIGKILL."""
        with suppress(ProcessLookupError):
            os.kill(self.pid, signal.SIGKILL)

    def end(self) -> None:
        """Kill the process and reap it."""
        self.kill()
        with suppress(ChildProcessError):
            os.waitpid(self.pid, 0)


class _Pipes(NamedTuple):
    heard: int
    lifeline: int
    told: int
    tell: int

    @classmethod
    def make(cls) -> _Pipes:
        """Create two pipes, whose ends no other child inherits."""
        return cls(*os.pipe(), *os.pipe())

    def ours(self, pid: int) -> Child:
        """Close the child's ends of the pipes, and return the child."""
        os.close(self.heard)
        os.close(self.tell)
        return Child(pid, self.lifeline, self.told)

    def close(self) -> None:
        """Close all four ends."""
        for descriptor in self:
            os.close(descriptor)


def copy_process(main: Callable[[int, int], object]) -> Child | None:
    """Fork this process, which shares the loaded modules; the child calls `main` with its two
    descriptors (read, write).

    Call it before this process enters ROS, because the threads of the middleware cannot be copied.
    Return None if the fork fails.
    """
    pipes = _Pipes.make()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # our other threads hold no lock that the child uses
            pid = os.fork()
    except OSError as error:
        sys.stderr.write(f"the stopper is started when it is needed: {error}\n")
        pipes.close()
        return None
    if pid:
        return pipes.ours(pid)
    try:
        os.setsid()
        os.dup2(pipes.heard, 0)
        os.dup2(pipes.tell, 1)
        os.closerange(3, ARCHIVE)
        os.closerange(ARCHIVE + 1, MOST_DESCRIPTORS)
        main(0, 1)
    finally:
        os._exit(1)


def spawn(name: str) -> Child:
    """Start this program again, from its beginning, as the stopper of that name. Raise `OSError` if that fails."""
    pipes = _Pipes.make()
    try:
        pid = os.posix_spawn(
            sys.executable,
            [sys.executable, *sys.orig_argv[1:], STOPPER_ARGUMENT, name],
            os.environ,
            file_actions=[
                (os.POSIX_SPAWN_DUP2, pipes.heard, 0),
                (os.POSIX_SPAWN_DUP2, pipes.tell, 1),
                *((os.POSIX_SPAWN_CLOSE, descriptor) for descriptor in _open_descriptors()),
            ],
            setsid=True,
        )
    except OSError:
        pipes.close()
        raise
    return pipes.ours(pid)


def _open_descriptors() -> list[int]:
    """Return all descriptors but the standard streams and the archive.

    The middleware lets children inherit its sockets and the locks on its memory, so they have to be closed.
    """
    numbers = map(int, (each.name for each in Path("/proc/self/fd").iterdir()))
    return [number for number in numbers if number > 2 and number != ARCHIVE]
