"""The processes that this run of pytest has started, directly or not: each inherits a mark in its environment.

What cleans the environment (an sshd for those who log in) passes `marks()` on; a child of a marked process, or of this
one, is found by its parents, too.
"""

from __future__ import annotations

import os
import signal
import sys
import time
import uuid
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import NamedTuple

END_S = 25.0
"""A node leaves within a second, a stopper 4 s after its bridge; a busy machine stretches that. Only ends a wait."""
POLL_S = 0.02
EXEC_S, EXEC_LOOK_S = 0.5, 0.001
"""How long a process that was forked may take to become another program, and how often it is looked at then."""
KTHREADD = 2
"""The parent of the kernel's own processes, which have no environment."""
ENDS_WITHOUT_A_WORD = (signal.SIGKILL, signal.SIGSTOP)
HALF = 0xFFFF
"""What Fast DDS keeps of a process id."""
MOST_CHARS = 300
"""Of a command line: a bridge's is a whole program."""
_PREFIX = "TESTS_OF_"
_NAME = f"{_PREFIX}{os.getpid()}"
_TICKS_PER_S = os.sysconf("SC_CLK_TCK")


class Process(NamedTuple):
    """A process of this machine. `started_s` is on the clock of `boot_s()`."""

    pid: int
    state: str
    parent: int
    group: int
    started_s: float

    @property
    def command(self) -> str:
        """Its command line in one line, or its name in brackets, as in ps(1)."""
        try:
            words = Path(f"/proc/{self.pid}/cmdline").read_bytes().split(b"\0")
            name = Path(f"/proc/{self.pid}/comm").read_text().strip()
        except OSError:
            return "[has ended]"
        return " ".join(b" ".join(words).decode(errors="replace").split())[:MOST_CHARS] or f"[{name}]"


def mark() -> None:
    """Whatever starts from now on is found. Marks of another pytest that has started this one stay."""
    os.environ.setdefault(_NAME, uuid.uuid4().hex)


def marks() -> dict[str, str]:
    """The variables of the environment that mark our processes."""
    return {name: value for name, value in os.environ.items() if name.startswith(_PREFIX)}


def boot_s() -> float:
    """The clock of processes' start times; the kernel gives those in hundredths of a second, rounded down."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


_commands: dict[int, str] = {}
_killed: set[int] = set()
"""Whom this process has killed (SIGKILL), or stopped (SIGSTOP): the product kills a bridge that no longer answers."""


def note_kills() -> None:
    """Keep the ids of those whom this process kills from now on, one by one or by group."""
    sys.addaudithook(_note_kill)


def killed_ids() -> set[int]:
    """The lower halves of the ids of those whom it has killed since."""
    return {pid & HALF for pid in _killed}


def seen(lower_half: int | None) -> str:
    """The command of one of our processes that was there when somebody asked for them, by the half of its id."""
    return _commands.get(lower_half, "") if lower_half else ""


def _note_kill(event: str, arguments: tuple[object, ...]) -> None:
    if event == "os.kill" and arguments[1] in ENDS_WITHOUT_A_WORD:
        _killed.add(int(str(arguments[0])))
    elif event == "os.killpg" and arguments[1] in ENDS_WITHOUT_A_WORD:
        _killed.update(pid for pid in listed() if (one := process(pid)) and one.group == arguments[0])


def listed() -> set[int]:
    """The ids of all processes of this machine; takes 0.2 ms."""
    return {int(name) for name in os.listdir("/proc") if name.isdigit()}  # noqa: PTH208 - twice as fast


def process(pid: int) -> Process | None:
    """That process, if there is one; one that has ended, and that nobody has waited for, is none."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except (FileNotFoundError, ProcessLookupError):  # the second if it ends while it is read
        return None
    if fields[0] in "ZX":
        return None
    return Process(pid, fields[0], int(fields[1]), int(fields[2]), int(fields[19]) / _TICKS_PER_S)


def environment(pid: int) -> dict[str, str]:
    """The environment that a process was started with; empty if it has ended or is not ours to ask."""
    try:
        data = Path(f"/proc/{pid}/environ").read_bytes()
    except OSError:
        return {}
    return dict(entry.partition("=")[::2] for entry in data.decode(errors="replace").split("\0") if entry)


def own(among: Iterable[int] | None = None) -> list[Process]:
    """Our processes, without this one: all, or those with these ids."""
    found: list[Process] = []
    for pid in listed() if among is None else among:
        if pid != os.getpid() and (one := process(pid)) and _is_own(one):
            _commands[one.pid & HALF] = one.command
            found.append(one)
    return sorted(found, key=lambda one: one.started_s)


def _is_own(one: Process) -> bool:
    while not (found := environment(one.pid)) and not _descends(one) and _may_be_in_exec(one):
        time.sleep(EXEC_LOOK_S)
    return found.get(_NAME) == os.environ.get(_NAME, "") or _descends(one)


def _may_be_in_exec(one: Process) -> bool:
    """Whether it lives and is so young that it may just become another program: it shows no environment meanwhile."""
    is_of_kernel = one.parent in (0, KTHREADD)
    return not is_of_kernel and boot_s() - one.started_s < EXEC_S and process(one.pid) is not None


def _descends(one: Process) -> bool:
    return any(ancestor == os.getpid() for ancestor in ancestors(one))


def ancestors(one: Process) -> list[int]:
    """Its parent, the parent of that, and so on."""
    found: list[int] = []
    parent: Process | None = one
    while parent and parent.parent > 1 and parent.parent not in found:
        found.append(parent.parent)
        parent = process(parent.parent)
    return found


def wait_for_end(left: Callable[[], list[Process]]) -> list[Process]:
    """Wait until nothing of that is left, at most END_S; what is after that time."""
    deadline = time.monotonic() + END_S
    while (still := left()) and time.monotonic() < deadline:
        time.sleep(POLL_S)
    return still


def kill(processes: Iterable[Process]) -> None:
    """End them at once, and wait until they have."""
    pids = {one.pid for one in processes}
    for pid in pids:
        try:
            os.kill(pid, signal.SIGKILL)
        except ProcessLookupError:
            continue
    wait_for_end(lambda: [one for pid in pids if (one := process(pid))])
