"""The processes of a step, found in /proc: its descendants in any session, and whatever carries its mark."""

from __future__ import annotations

import contextlib
import ctypes
import os
import re
import resource
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

MARK = "ROS2_MCP_CI"
"""An environment variable that every process of a step inherits: the pids of its runners, outermost first."""
TERM_GRACE_S = 3.0
"""Time between SIGTERM and SIGKILL: pytest, servers and bridges that can end by themselves need less than 1 s."""
KILL_PATIENCE_S = 5.0
"""After SIGKILL a process is gone at once, unless the kernel holds it."""
STACK_S = 4.0
"""`py-spy dump` takes about 0.5 s, and some 2 s on a busy machine."""
ALL_STACKS_S = 12.0
"""For the stacks of all processes together, so that the step still ends within 30 s of its bound."""
ABORT_S = 2.0
"""faulthandler writes the stacks within milliseconds of SIGABRT."""
_SUBREAPER = 36
"""PR_SET_CHILD_SUBREAPER of <linux/prctl.h>."""


class Process(NamedTuple):
    """What /proc says of one process."""

    pid: int
    ppid: int
    group: int
    session: int
    state: str
    started_s: float
    """Seconds since boot."""
    command: str

    @property
    def is_python(self) -> bool:
        """Whether it runs an interpreter of Python."""
        with contextlib.suppress(OSError):
            return "python" in Path(f"/proc/{self.pid}/exe").readlink().name
        return False


def adopt_orphans() -> None:
    """A descendant whose parent has ended becomes a child of this process, so that it is still found (Linux only)."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_SUBREAPER, 1, 0, 0, 0)


def no_core_files() -> None:
    """SIGABRT asks for stacks; it must not fill the disk."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, resource.getrlimit(resource.RLIMIT_CORE)[1]))


def processes_of(mark: str) -> list[Process]:
    """All that descend from this process or carry the mark, parents before children; not this process, no zombies."""
    everything = {process.pid: process for process in _all()}
    me = os.getpid()
    found = []
    for process in everything.values():
        if process.pid == me or process.state == "Z":
            continue
        if me in _ancestors(process, everything) or carries(process.pid, mark):
            found.append(process)
    return _in_tree_order(found)


def _ancestors(process: Process, everything: dict[int, Process]) -> list[int]:
    above: list[int] = []
    while process.ppid in everything and process.ppid not in above:
        above.append(process.ppid)
        process = everything[process.ppid]
    return above


def carries(pid: int, mark: str) -> bool:
    """Whether a process was started with this mark, in a step or in a step within that."""
    with contextlib.suppress(OSError):
        for variable in Path(f"/proc/{pid}/environ").read_bytes().split(b"\0"):
            name, _, value = variable.partition(b"=")
            if name == MARK.encode():
                return value == mark.encode() or value.startswith(mark.encode() + b":")
    return False


def _all() -> list[Process]:
    found = (_read(int(path.name)) for path in Path("/proc").iterdir() if path.name.isdigit())
    return [process for process in found if process]


def _read(pid: int) -> Process | None:
    try:
        stat = Path(f"/proc/{pid}/stat").read_text(errors="replace")
        command = Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace").strip()
    except OSError:
        return None  # it has ended
    name, fields = stat[stat.index("(") : stat.rindex(")") + 1], stat[stat.rindex(")") + 2 :].split()
    started_s = int(fields[19]) / os.sysconf("SC_CLK_TCK")
    return Process(pid, int(fields[1]), int(fields[2]), int(fields[3]), fields[0], started_s, command or name)


def _in_tree_order(found: Sequence[Process]) -> list[Process]:
    pids = {process.pid for process in found}
    ordered: list[Process] = []

    def add(process: Process) -> None:
        ordered.append(process)
        for child in sorted(found):
            if child.ppid == process.pid:
                add(child)

    for root in sorted(found):
        if root.ppid not in pids:
            add(root)
    return ordered


def tree(found: Sequence[Process]) -> list[str]:
    """A line for each process, indented below its parent."""
    uptime_s = float(Path("/proc/uptime").read_text().split()[0])
    depth: dict[int, int] = {}
    lines = []
    for process in found:
        depth[process.pid] = depth.get(process.ppid, -1) + 1
        age_s = uptime_s - process.started_s
        facts = f"pid {process.pid}, session {process.session}, {process.state}, {age_s:.0f} s"
        lines.append(f"{'  ' * depth[process.pid]}{facts}: {process.command[:300]}")
    return lines


def stacks(found: Sequence[Process], say: Callable[[str], None]) -> list[Process]:
    """Says where each process stands; returns the Python processes whose stacks could not be read from outside."""
    py_spy = _py_spy()
    deadline = time.monotonic() + ALL_STACKS_S
    unread: list[Process] = []

    def read(process: Process) -> str | None:
        left_s = min(STACK_S, deadline - time.monotonic())
        if not py_spy or left_s <= 0:
            return None
        return _run([py_spy, "dump", "--pid", str(process.pid)], left_s)

    pythons = [process for process in found if process.is_python]
    with ThreadPoolExecutor(max_workers=4) as pool:
        readings = [(process, pool.submit(read, process)) for process in pythons]
        for process, reading in readings:
            text = reading.result()
            if text is None:
                unread.append(process)
                say(f"Where process {process.pid} stands: {_kernel_facts(process.pid)}\n{process.command[:300]}")
            else:
                say(f"Python stacks of process {process.pid}:\n{text}")
    for process in found:
        if process not in pythons:
            say(f"Where process {process.pid} stands: {_kernel_facts(process.pid)}\n{process.command[:300]}")
    return unread


def _py_spy() -> str | None:
    """In the environment of the tests, or anywhere on the path."""
    root = Path(__file__).resolve().parents[1]
    return shutil.which("py-spy", path=os.pathsep.join([f"{root}/.venv/bin", os.environ.get("PATH", os.defpath)]))


def _run(command: Sequence[str], bound_s: float) -> str | None:
    """What a command prints, or None if it fails or does not end in time."""
    nothing = subprocess.DEVNULL
    try:
        process = subprocess.Popen(command, stdin=nothing, stdout=subprocess.PIPE, stderr=nothing)
        text = process.communicate(timeout=bound_s)[0].decode(errors="replace").strip()
    except OSError:
        return None
    except subprocess.TimeoutExpired:
        process.kill()  # and not waited for: where the kernel holds it, that would take as long
        return None
    return text if process.returncode == 0 else None


def _kernel_facts(pid: int) -> str:
    facts = []
    with contextlib.suppress(OSError):
        for line in Path(f"/proc/{pid}/status").read_text(errors="replace").splitlines():
            if line.startswith(("State:", "Threads:")):
                facts.append(" ".join(line.split()))
    with contextlib.suppress(OSError):
        facts.append(f"waits in: {Path(f'/proc/{pid}/wchan').read_text()}")
    with contextlib.suppress(OSError):  # root alone may read it
        calls = re.findall(r"(\S+)\+0x", Path(f"/proc/{pid}/stack").read_text())
        facts.append(f"kernel stack: {' ← '.join(calls[:6])}")
    return "; ".join(facts)


def send(found: Sequence[Process], number: int) -> None:
    """A signal to each of these, if it is still the same process."""
    for process in found:
        now = _read(process.pid)
        if now and now.started_s == process.started_s:
            with contextlib.suppress(OSError):
                os.kill(process.pid, number)


def end(mark: str, relay: Callable[[], object]) -> list[Process]:
    """SIGTERM, and after a grace SIGKILL, for all that is there; returns what even SIGKILL did not end.

    Asked again until nothing is found, since a process may start another one meanwhile. `relay` is called in between,
    so that none is kept from ending by a pipe that nobody reads.
    """
    told: dict[int, float] = {}
    kill_at = time.monotonic() + TERM_GRACE_S
    give_up_at = kill_at + KILL_PATIENCE_S
    while left := processes_of(mark):
        if time.monotonic() >= give_up_at:
            return left
        if time.monotonic() >= kill_at:
            send(left, signal.SIGKILL)
        else:
            new = [process for process in left if told.get(process.pid) != process.started_s]
            send(new, signal.SIGTERM)
            send(new, signal.SIGCONT)  # one that is stopped could not end by SIGTERM
            told.update({process.pid: process.started_s for process in new})
        relay()
        reap()
        time.sleep(0.05)
    return []


def reap() -> dict[int, int]:
    """The statuses of the children that have ended since the last time, by pid: their own and adopted ones."""
    statuses: dict[int, int] = {}
    while True:
        try:
            pid, status = os.waitpid(-1, os.WNOHANG)
        except ChildProcessError:
            return statuses
        if pid == 0:
            return statuses
        statuses[pid] = status
