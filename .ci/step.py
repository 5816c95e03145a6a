"""Runs one command as a step that cannot hang: `python3 .ci/step.py NAME SECONDS COMMAND [ARGUMENT...]`.

Needs Python 3.9 and its standard library only. The command runs in a session of its own, and what it and its
descendants print is relayed from a pipe, so that a descendant which keeps that pipe open holds up nothing.

At the bound it prints the processes of the step, where each stands, and which tests had not ended; then it ends them
all, and the status is 124. A process that is left when the command has ended is named and ended, and fails the step.
SIGINT, SIGTERM and SIGHUP end everything as well. Otherwise the status is the command's.
"""

from __future__ import annotations

import os
import selectors
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path

import processes

RUNNING_TESTS = "ROS2_MCP_RUNNING_TESTS"
"""The folder where each process of pytest notes what it runs; `tests/support/running_tests.py` writes there."""
BOUND_STATUS = 124
"""As of `timeout` of GNU coreutils."""
LEFT_STATUS = 3
LEFT_GRACE_S = 5.0
"""What was told to end, such as a browser's or a bridge's own children, may need so long after its parent."""
DRAIN_S = 1.0
"""For reading what is left in the pipe when the command has ended, though others keep it open."""
TICK_S = 0.5
"""Signals and output wake the loop; this is only how late the bound may be noticed."""


class Step:
    """One command, its output and its end."""

    def __init__(self, name: str, bound_s: float, command: list[str]) -> None:
        self._name = name
        self._bound_s = bound_s
        outer = os.environ.get(processes.MARK)
        self._mark = f"{outer}:{os.getpid()}" if outer else str(os.getpid())
        outer_notes = os.environ.get(RUNNING_TESTS, "")  # of a step around this one, which tells these as well
        within = outer_notes if Path(outer_notes).is_dir() and outer_notes else None
        self._notes = Path(tempfile.mkdtemp(prefix="ros2_mcp_running_tests_", dir=within))
        self._signal: int | None = None
        self._output = b""
        self._wake_read, wake_write = os.pipe()
        for descriptor in (self._wake_read, wake_write):
            os.set_blocking(descriptor, False)
        signal.set_wakeup_fd(wake_write, warn_on_full_buffer=False)
        # With a handler for each, the command starts with the default for all, even where bash ignores some of them.
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT):
            signal.signal(number, self._note_signal)
        signal.signal(signal.SIGCHLD, lambda *_: None)
        processes.adopt_orphans()
        processes.no_core_files()
        self._read, write = os.pipe()
        os.set_blocking(self._read, False)
        environment = {
            **os.environ,
            processes.MARK: self._mark,
            RUNNING_TESTS: str(self._notes),
            "PYTHONFAULTHANDLER": "1",  # stacks on SIGABRT, where no debugger may look from outside
        }
        self._deadline = time.monotonic() + bound_s
        self._process = subprocess.Popen(
            command, env=environment, stdin=subprocess.DEVNULL, stdout=write, stderr=write, start_new_session=True
        )
        os.close(write)

    def run(self) -> int:
        """The status of the step, once nothing of it is left."""
        try:
            status = self._relay_until_the_end()
            if self._signal is not None:
                self._say(f"was told to end by signal {self._signal}")
                self._end_all()
                return 128 + self._signal
            if status is None:
                return self._at_the_bound()
            return self._after_the_end(status)
        finally:
            shutil.rmtree(self._notes, ignore_errors=True)

    def _relay_until_the_end(self) -> int | None:
        """Relays output until the command has ended, and gives its status; None at the bound or after a signal."""
        with selectors.DefaultSelector() as selector:
            selector.register(self._read, selectors.EVENT_READ)
            selector.register(self._wake_read, selectors.EVENT_READ)
            while True:
                status = processes.reap().get(self._process.pid)
                if status is not None:
                    code = os.waitstatus_to_exitcode(status)
                    return code if code >= 0 else 128 - code
                left_s = self._deadline - time.monotonic()
                if self._signal is not None or left_s <= 0:
                    return None
                for key, _ in selector.select(min(left_s, TICK_S)):
                    if key.fd == self._wake_read:
                        os.read(self._wake_read, 4096)
                    elif not self._relay():
                        selector.unregister(self._read)  # all have closed it

    def _relay(self) -> bool:
        """Prints the complete lines of what is there; False when nobody can write any more."""
        try:
            more = os.read(self._read, 1 << 16)
        except BlockingIOError:
            return True
        self._output += more
        lines, newline, self._output = self._output.rpartition(b"\n")
        if newline:
            _write(lines + newline)
        return bool(more)

    def _drain(self) -> None:
        """Relays what is in the pipe now, and what comes within a moment."""
        until = time.monotonic() + DRAIN_S
        with selectors.DefaultSelector() as selector:
            selector.register(self._read, selectors.EVENT_READ)
            while (left_s := until - time.monotonic()) > 0 and selector.select(min(left_s, 0.2)):
                if not self._relay():
                    break
        self._relay_incomplete_line()

    def _relay_incomplete_line(self) -> None:
        if self._output:
            _write(self._output + b"\n")
            self._output = b""

    def _after_the_end(self, status: int) -> int:
        self._drain()
        until = time.monotonic() + LEFT_GRACE_S
        while (left := processes.processes_of(self._mark)) and time.monotonic() < until and self._signal is None:
            time.sleep(0.05)
            processes.reap()
        if not left:
            return status
        self._say(f"has left these processes behind, {LEFT_GRACE_S:.0f} s after its end")
        _write("\n".join(processes.tree(left)).encode() + b"\n")
        self._end_all()
        return status or LEFT_STATUS

    def _at_the_bound(self) -> int:
        self._say(f"has not ended within its bound of {self._bound_s:.0f} s")
        found = processes.processes_of(self._mark)
        _write(b"\n".join([b"Its processes:", *(line.encode() for line in processes.tree(found)), b""]))
        self._say_which_tests_run()
        unread = processes.stacks(found, lambda text: _write(f"\n{text}\n".encode()))
        for process in reversed(unread):  # children first: an end of their parents would end them without a word
            processes.send([process], signal.SIGABRT)  # faulthandler writes the stacks to the pipe
            self._relay_for(processes.ABORT_S / len(unread))
        self._end_all()
        return BOUND_STATUS

    def _say_which_tests_run(self) -> None:
        """Each note is named after a worker and a pid, and says what it does and since when."""
        notes = sorted(path for path in self._notes.rglob("*") if path.is_file())
        if not notes:
            return
        _write(b"Tests that had not ended:\n")
        for note in notes:
            with suppress(OSError):
                age_s = time.time() - note.stat().st_mtime
                _write(f"{note.name}, for {age_s:.0f} s: {note.read_text(errors='replace')}\n".encode())

    def _relay_for(self, seconds: float) -> None:
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            self._relay()
            time.sleep(0.02)

    def _end_all(self) -> None:
        stubborn = processes.end(self._mark, self._relay)
        self._drain()
        if stubborn:
            self._say("could not end")
            _write("\n".join(processes.tree(stubborn)).encode() + b"\n")

    def _say(self, what: str) -> None:
        self._relay_incomplete_line()
        _write(f"\n*** The step {self._name!r} {what}.\n".encode())

    def _note_signal(self, number: int, _frame: object) -> None:
        self._signal = number


def _write(text: bytes) -> None:
    """To stdout, in pieces, whatever it is; a reader that has gone ends nothing."""
    with suppress(BrokenPipeError):
        sys.stdout.buffer.write(text)
        sys.stdout.buffer.flush()


if __name__ == "__main__":
    sys.exit(Step(sys.argv[1], float(sys.argv[2]), sys.argv[3:]).run())
