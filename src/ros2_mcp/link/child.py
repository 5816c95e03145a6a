"""A child process whose pipes carry the stream: the bridge itself, or the program that reaches a remote bridge.

In the link, only this module uses processes: signals, exit codes and `/proc`.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path

from ros2_mcp.link.installation import Command
from ros2_mcp.link.threaded import ThreadedReader, ThreadedWriter
from ros2_mcp_common.wire.limits import BATCH_BYTES

# Enough for a traceback. Error messages show its last few lines, `doctor` and the log all.
_KEPT_LINES = 50
# The longest kept line: output without newlines must not fill the memory.
_COLOURS = re.compile(rb"\x1b\[[0-9;]*[A-Za-z]")
"""Colour codes, which DDS libraries print even where nobody sees colours."""
_MAX_LINE_BYTES = 2000
# Above this size of the write queue, sending the next body waits: a bridge that does not read must not fill the memory.
_WRITE_BUFFER_BYTES = 1024 * 1024
# The size of the pipes: a packet of samples fits, with fewer wake-ups for images than the default of 64 kB.
_PIPE_BYTES = BATCH_BYTES
# The polling period for the exit of the process: Popen cannot await it without a thread or a child watcher.
_POLL_S = 0.01
# The time limit for the exit code in error messages: the pipe usually ends shortly before the code is available.
_EXIT_CODE_S = 0.5
# From SIGTERM to SIGKILL: on SIGTERM a bridge exits as at the end of its stdin, for which `close` has given it time.
_TERMINATE_S = 0.3
_SHARED_MEMORY = "/dev/shm"
# LTTng, which rclpy loads, maps a page of shared memory when a process starts, and dies with SIGBUS if none is free.
_FULL = f", as {_SHARED_MEMORY} is full: make room there (df {_SHARED_MEMORY}; --shm-size of a container)"
if sys.platform == "win32":
    # Ctrl+C in the server's terminal does not reach the child, and it opens no console window.
    _CREATION_FLAGS = subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.CREATE_NO_WINDOW
else:
    _CREATION_FLAGS = 0
_SET_PIPE_SIZE = 1031  # F_SETPIPE_SZ of Linux; the fcntl module knows it by name from Python 3.10 on Linux only


class Child:
    """A process in its own session, so that Ctrl-C in the server's terminal does not reach it."""

    def __init__(
        self, command: Command, *, pass_stderr: bool = False, threaded: bool = sys.platform == "win32"
    ) -> None:
        """Start the process without waiting for anything.

        Args:
            command: the command and its environment.
            pass_stderr: whether to copy its stderr to this process's stderr.
            threaded: whether threads wait for its pipes, as Windows requires.

        Raises:
            OSError: if it cannot be executed.
        """
        self._process = subprocess.Popen(
            command.argv,
            env=command.env,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            bufsize=0,
            start_new_session=True,
            creationflags=_CREATION_FLAGS,
        )
        self._is_threaded = threaded
        self.pid = self._process.pid
        self._errors = ErrorLines(pass_stderr)
        self._input = _Pipe(lambda _: None)
        self._pipes: list[asyncio.BaseTransport] = []
        self._writer: asyncio.WriteTransport | None = None

    async def open(self, received: Callable[[bytes], None], ended: Callable[[], None]) -> None:
        """Connect the pipes to the running event loop."""
        loop = asyncio.get_running_loop()
        process = self._process
        assert process.stdin and process.stdout and process.stderr
        _enlarge(process.stdout.fileno())
        _enlarge(process.stdin.fileno())
        if self._is_threaded:
            self._writer = ThreadedWriter(process.stdin, self._input, _WRITE_BUFFER_BYTES)
            errors = ThreadedReader(process.stderr, _Pipe(self._errors.feed))
            self._pipes += [self._writer, errors, ThreadedReader(process.stdout, _Pipe(received, ended))]
            return
        self._writer, _ = await loop.connect_write_pipe(lambda: self._input, process.stdin)
        self._writer.set_write_buffer_limits(high=_WRITE_BUFFER_BYTES)
        self._pipes.append(self._writer)
        errors, _ = await loop.connect_read_pipe(lambda: _Pipe(self._errors.feed), process.stderr)
        self._pipes.append(errors)
        output, _ = await loop.connect_read_pipe(lambda: _Pipe(received, ended), process.stdout)
        self._pipes.append(output)

    def write_at_once(self, data: bytes) -> bytes:
        """Write to its stdin what fits into the pipe, before there is an event loop; return the rest."""
        assert self._process.stdin
        if sys.platform == "win32" or self._is_threaded:
            return data
        _enlarge(self._process.stdin.fileno())
        os.set_blocking(self._process.stdin.fileno(), False)
        with contextlib.suppress(BrokenPipeError):  # it has ended, which is noticed later
            data = data[os.write(self._process.stdin.fileno(), data) :]
        return data

    def write(self, data: bytes) -> None:
        """Queue bytes for its stdin, in order; bytes for a process that has ended are discarded."""
        if self._writer and not self._writer.is_closing():
            self._writer.write(data)

    async def writable(self) -> None:
        """Wait while more than a megabyte is queued."""
        await self._input.writable.wait()

    async def ending(self) -> str:
        """Return how the process ended, from its exit code, in words that follow the subject."""
        code = await self.exit_code(_EXIT_CODE_S)
        if code is None:
            return "closed its stream"
        if code >= 0:
            return f"exited with code {code}"
        names = {number.value: number.name for number in signal.Signals}
        name = names.get(-code, str(-code))
        return f"died with signal {name}{_FULL if name == 'SIGBUS' and _is_memory_full() else ''}"

    def log_tail(self) -> list[str]:
        """Return the last lines of its stderr."""
        return self._errors.tail

    def kill(self) -> None:
        """Send SIGKILL to its whole session; on Windows only to the process itself."""
        if sys.platform == "win32":
            self._process.kill()
        else:
            self._signal(signal.SIGKILL)

    async def close(self, grace_s: float) -> None:
        """Close its stdin and wait up to `grace_s` seconds for its exit; then send SIGTERM, then SIGKILL. Leaves no
        zombie.
        """
        self._close_input()
        try:
            if await self.exit_code(grace_s) is None:
                self._signal(signal.SIGTERM)
                await self.exit_code(_TERMINATE_S)
        finally:
            self.kill()
            self._close_pipes()
            self._process.wait()
        await asyncio.sleep(0)  # lets the transports close their file descriptors

    async def exit_code(self, timeout_s: float = _EXIT_CODE_S) -> int | None:
        """Return the exit code, negative for a signal; None if the process still runs after the time-out."""
        deadline = time.monotonic() + timeout_s
        while self._process.poll() is None and time.monotonic() < deadline:
            await asyncio.sleep(_POLL_S)
        return self._process.poll()

    def _signal(self, number: signal.Signals) -> None:
        if self._process.poll() is not None:
            return
        with contextlib.suppress(ProcessLookupError, PermissionError):
            if sys.platform == "win32":
                self._process.send_signal(number)
            else:
                os.killpg(self.pid, number)

    def _close_input(self) -> None:
        if self._writer:
            self._writer.close()
        elif self._process.stdin:
            self._process.stdin.close()

    def _close_pipes(self) -> None:
        # `close` ends the writer once its queue is empty; `abort` after that would end it a second time. A queue that a
        # dead process never reads would keep the writer open for ever.
        if self._writer and self._writer.get_write_buffer_size():
            self._writer.abort()
        for pipe in self._pipes:
            pipe.close()
        if not self._pipes:
            for pipe in (self._process.stdin, self._process.stdout, self._process.stderr):
                if pipe:
                    pipe.close()


class ErrorLines:
    """The last lines of a child's stderr, decoded."""

    def __init__(self, pass_on: bool) -> None:
        self._pass_on = pass_on
        self._lines: deque[str] = deque(maxlen=_KEPT_LINES)
        self._begun = b""

    def feed(self, piece: bytes) -> None:
        """Add output; copy it to this process's stderr if requested."""
        if self._pass_on:
            sys.stderr.write(piece.decode(errors="replace"))
        *whole, self._begun = (self._begun + piece).split(b"\n")
        self._lines.extend(_plain(line) for line in whole if line.strip())
        self._begun = self._begun[-_MAX_LINE_BYTES:]

    @property
    def tail(self) -> list[str]:
        """The last lines, oldest first; at most 50, and an unfinished line."""
        return [*self._lines, *([_plain(self._begun)] if self._begun.strip() else [])]


class _Pipe(asyncio.Protocol):
    """Passes on the bytes from a pipe, and its end. `writable` is set while the pipe accepts more."""

    def __init__(self, on_bytes: Callable[[bytes], None], on_end: Callable[[], None] = lambda: None) -> None:
        self.writable = asyncio.Event()
        self.writable.set()
        self._on_bytes = on_bytes
        self._on_end = on_end

    def data_received(self, data: bytes) -> None:
        self._on_bytes(data)

    def pause_writing(self) -> None:
        self.writable.clear()

    def resume_writing(self) -> None:
        self.writable.set()

    def connection_lost(self, exc: Exception | None) -> None:  # noqa: ARG002
        self.writable.set()
        self._on_end()


def thread_states(pid: int) -> set[str]:
    """Return the states of a process's threads from /proc: R running, S sleeping, D disk, T stopped, Z zombie."""
    states: set[str] = set()
    for stat in Path(f"/proc/{pid}/task").glob("*/stat"):
        with contextlib.suppress(OSError):
            states.add(stat.read_text(errors="replace").rpartition(")")[2].split()[0])
    return states


def _plain(line: bytes) -> str:
    return _COLOURS.sub(b"", line)[-_MAX_LINE_BYTES:].decode(errors="replace").rstrip()


def _enlarge(pipe: int) -> None:
    """Enlarge a pipe from 64 kB to a megabyte, which means fewer wake-ups for images. A refusal is ignored."""
    if sys.platform == "linux":
        import fcntl

        with contextlib.suppress(OSError):
            fcntl.fcntl(pipe, _SET_PIPE_SIZE, _PIPE_BYTES)


def _is_memory_full() -> bool:
    """Return whether this machine's shared memory is full."""
    with contextlib.suppress(OSError):
        return shutil.disk_usage(_SHARED_MEMORY).free == 0
    return False
