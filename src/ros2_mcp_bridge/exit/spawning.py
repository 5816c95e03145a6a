"""A second process beside this one, in a session of its own: what ends ours spares it."""

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
"""What the process list shows of the two stoppers: no pattern that finds the bridge or the server finds one of them."""
# Descriptors that a copy of this process closes: it would keep the stream to the server open. More than there are.
MOST_DESCRIPTORS = 65536
_FILE_IN_MEMORY = re.match(r"/(?:proc/self|dev)/fd/(\d+)/", __file__)
ARCHIVE = int(_FILE_IN_MEMORY[1]) if _FILE_IN_MEMORY else MOST_DESCRIPTORS
"""The descriptor of the zip that a bridge which was sent (see stage1.py) is imported from; a child needs it, too."""


class Child(NamedTuple):
    """A process, the writing end of its stdin, and the reading end of its stdout."""

    pid: int
    lifeline: int
    told: int

    def has_ended(self) -> bool:
        """Whether it has; leaves no zombie then."""
        with suppress(ChildProcessError):  # it has been waited for
            return os.waitpid(self.pid, os.WNOHANG)[0] != 0
        return True

    def has_unread(self) -> bool:
        """Whether something on its stdin was not read yet."""
        return any(fcntl.ioctl(self.lifeline, termios.FIONREAD, bytes(4)))

    def kill(self) -> None:
        """End it at once."""
        with suppress(ProcessLookupError):
            os.kill(self.pid, signal.SIGKILL)

    def end(self) -> None:
        """End it, and leave no zombie."""
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
        """Two pipes, whose ends no other child inherits."""
        return cls(*os.pipe(), *os.pipe())

    def ours(self, pid: int) -> Child:
        """Close the child's ends."""
        os.close(self.heard)
        os.close(self.tell)
        return Child(pid, self.lifeline, self.told)

    def close(self) -> None:
        """Close all."""
        for descriptor in self:
            os.close(descriptor)


def copy_process(main: Callable[[int, int], object]) -> Child | None:
    """A copy of this process, which has loaded what it needs and shares that memory; `main` gets its two descriptors.

    To be made before this process enters ROS, because the threads of the middleware cannot be copied. None where a copy
    is refused.
    """
    pipes = _Pipes.make()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # our other threads hold nothing that the copy uses
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
    """This program once more, from its beginning, as the stopper of that name; raises `OSError`."""
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
    """All but the standard streams and the archive: the middleware lets children inherit its sockets, and the locks on
    its memory.
    """
    numbers = map(int, (each.name for each in Path("/proc/self/fd").iterdir()))
    return [number for number in numbers if number > 2 and number != ARCHIVE]
