"""The audit: the requests, decisions and outcomes of commands, written before and after each command (decision 31).

Under a policy that requires the audit, a command is carried out only once its line is written. Without a policy the
line is written concurrently, and a disk that cannot be written to is logged once. A stop never waits for a line.
"""

from __future__ import annotations

import asyncio
import json
import logging
import os
import time
from collections.abc import Callable, Generator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from threading import Lock
from time import monotonic
from typing import Any

from ros2_mcp.guard.audit_file import FILE_BYTES, KEEP_BYTES, ROOM_BYTES, AuditFile
from ros2_mcp.guard.chain import HEAD, Head, parse_head
from ros2_mcp.model.errors import Refused, RobotError
from ros2_mcp.model.times import iso_time

_ASKED = ("act", "waits", "refused", "refused part")
"""Kinds of lines about a client's request."""
VALUE_CHARACTERS = 1000
"""The longest value in a line, in characters of JSON. A longer value is cut; its digest covers all of it."""
_TEXT_CHARACTERS = 300
"""The longest text in any other field, such as the reason of a refusal, in characters."""
COPIED_EVERY_S = 60.0
"""Under a policy, how often the head is copied to the log, in s. For a service the log is the journal, out of reach of
users who can write in the audit's folder. Lines before a copied head cannot be removed or rewritten unnoticed."""
MOST_QUEUED = 10_000
"""The most lines, 30 MB at most, that wait for a disk that hangs. Further lines are counted, and not written."""
TOGETHER_S = 0.02
"""Without a policy, how long a line that no caller awaits waits for further lines, so that ten programs that act at
once delay this process less. A kill loses the lines of that time. Not measured."""
_logger = logging.getLogger(__name__)


@dataclass(slots=True)
class CallOfTool:
    """One call of a tool: the tool, the place in a program where it was called (`program_0f3a9c21, line 3`), and
    whether the audit has a line about it.
    """

    tool: str = ""
    has_line: bool = False
    program: str = ""


_call: ContextVar[CallOfTool] = ContextVar("call", default=CallOfTool())  # noqa: B039 - shared, but never read

Line = Future[Head]
"""The future of a line that is being written; its result is the head after it."""
_Queued = tuple[Line, Mapping[str, Any], int, Line | None]
"""A queued line: its future, its fields, the free space that it requires on the disk in bytes, and, for an outcome, the
line of its command."""
Listener = Callable[[int, Mapping[str, Any]], None]
"""Is called with each entry and the time when it was made (UNIX time in ns). Must neither block nor raise."""


@contextmanager
def called_through(tool: str, program: str = "") -> Generator[CallOfTool, None, None]:
    """Attribute the audit lines made in this context to this call of a tool."""
    token = _call.set(call := CallOfTool(tool, program=program))
    try:
        yield call
    finally:
        _call.reset(token)


class Audit:
    """The audit of one robot. Without a folder nothing is written, and entries only reach the listeners.

    `folder` returns the folder, and creates it if necessary; it is called when the first line is written. `path` is the
    same folder, for reading. `required`: a command is refused if its line cannot be written. `failed` is the reason why
    the last line could not be written, "" if it was. `head` is the end of the chain as far as this server has written
    it.
    """

    def __init__(
        self,
        folder: Callable[[], Path] | None,
        *,
        path: Path | None = None,
        policy: str = "",
        required: bool = False,
        file_bytes: int = FILE_BYTES,
        keep_bytes: int = KEEP_BYTES,
    ) -> None:
        self.path = path
        self.keep_bytes = keep_bytes
        self.required = required
        self.failed = ""
        self._policy = policy
        self._listeners: list[Listener] = []
        self._unwritten = 0
        self._folder = folder
        self._open = partial(AuditFile, file_bytes=file_bytes, keep_bytes=keep_bytes)
        self._file: AuditFile | None = None
        # One thread: lines are written in the order in which they were made, and a slow disk does not block the event
        # loop.
        self._writer = ThreadPoolExecutor(1, "audit")
        self._syncer = ThreadPoolExecutor(1, "audit-sync")
        self._syncing: Future[None] | None = None
        self._queue_lock = Lock()
        self._queue_of_lines: list[_Queued] = []
        self._is_closed = False
        self._copied, self._copied_at = 0, monotonic()

    @property
    def head(self) -> Head:
        """The end of the chain as far as this server knows it; before its first line, the head found on disk."""
        if self._file:
            return self._file.head
        try:
            return (self.path and parse_head((self.path / HEAD).read_bytes())) or Head()
        except OSError:
            return Head()

    async def before(self, fields: Mapping[str, Any], *, stops: bool = False) -> Line | None:
        """Write the line of a command that is about to be carried out, and return it, for `after`.

        Under a policy this waits until the line is written, unless `stops`: a stop never waits. None if nothing is
        written.

        Raises:
            Refused: if the line cannot be written and the audit is required.
        """
        line = self._queue("act", fields, 0 if stops else ROOM_BYTES)
        if self._folder is None or stops or not (self.required or self._policy):
            return line
        try:
            if line is None:
                raise OSError("it is closed")
            await asyncio.wrap_future(line)
        except (OSError, RobotError) as error:
            if self.required:
                raise Refused(
                    f"Nothing was sent: the audit cannot be written ({self.failed or error}), and the policy requires "
                    "it.",
                    "Tell the operator. ros2_stop still works.",
                ) from error
        return line

    def after(self, line: Line | None, outcome: str, **more: Any) -> None:
        """Queue the outcome of the command with that line; do not wait for the write."""
        self._queue("outcome", {"of": _number_of(line), "outcome": outcome, **more}, of=line)

    def note(self, kind: str, **fields: Any) -> None:
        """Queue one line about an event, such as a stop or an approval; do not wait for the write."""
        self._queue(kind, fields)

    async def written(self) -> None:
        """Wait until the lines that are queued now are written or have failed."""
        with suppress(RuntimeError):  # the audit is closed, and everything is written
            await asyncio.wrap_future(self._writer.submit(lambda: None))

    @contextmanager
    def listened(self, listener: Listener) -> Generator[None, None, None]:
        """Pass every entry, written or not, to `listener` in this context."""
        self._listeners.append(listener)
        try:
            yield
        finally:
            self._listeners.remove(listener)

    def close(self) -> None:
        """Write and sync the queued lines, and close the file. Later lines are not written."""
        with self._queue_lock:
            self._is_closed = True
        self._writer.shutdown()
        self._syncer.shutdown()
        if self._file:
            self._copy_head(self._file.head)
            self._file.close()

    def _entry(self, kind: str, fields: Mapping[str, Any]) -> Mapping[str, Any]:
        now_ns = time.time_ns()
        entry: dict[str, Any] = {"kind": kind, "time": iso_time(now_ns), "monotonic": round(monotonic(), 6)}
        if kind in _ASKED:
            call = _call.get()
            call.has_line = True
            entry |= {"tool": call.tool, "policy": self._policy}
            if call.program:
                entry["program"] = call.program
        entry |= {name: _bounded(name, value) for name, value in fields.items() if value not in (None, "")}
        for listener in self._listeners:
            listener(now_ns, entry)
        return entry

    def _queue(self, kind: str, fields: Mapping[str, Any], room_bytes: int = 0, of: Line | None = None) -> Line | None:
        """Append a line to the queue of the writing thread, and return it; None if it will not be written."""
        entry = self._entry(kind, fields)
        if self._folder is None:
            return None
        line = Line()
        line.add_done_callback(self._note_outcome)
        with self._queue_lock:
            if self._is_closed:
                return None
            if len(self._queue_of_lines) >= MOST_QUEUED and not self.required:
                self._unwritten += 1
                return None
            if not self._queue_of_lines:
                self._writer.submit(self._write_queued)
            self._queue_of_lines.append((line, entry, room_bytes, of))
        return line

    def _note_outcome(self, line: Line) -> None:
        if line.cancelled():  # the call that waited for it was cancelled: nothing was sent
            return
        error = line.exception()
        if isinstance(error, (OSError, RobotError)):
            self._unwritten += 1
            self._note_failure(error)
        elif error:
            _logger.error("a line of the audit was not written: %r", error)

    def _note_failure(self, error: OSError | RobotError) -> None:
        why = str((isinstance(error, OSError) and error.strerror) or error)
        if not self.failed:
            _logger.warning("the audit cannot be written: %s", why)
        self.failed = why.rstrip(".")

    # ── in the threads ─────────────────────────────────────────────────────────────────────────────────────────────

    def _write_queued(self) -> None:
        """Write all queued lines."""
        if not (self.required or self._policy):
            time.sleep(TOGETHER_S)
        with self._queue_lock:
            queued, self._queue_of_lines = self._queue_of_lines, []
        running = [one for one in queued if one[0].set_running_or_notify_cancel()]
        try:
            if self._file is None:
                assert self._folder
                self._file = self._open(self._folder())
            with self._file.held():
                for one in running:
                    self._write(self._file, *one)
        except Exception as error:  # noqa: BLE001 - whatever the error is, the waiters must get it
            for line, *_ in running:
                if not line.done():
                    line.set_exception(error)
        if self._file and (self._syncing is None or self._syncing.done()):
            # One sync at a time: lines written meanwhile are synced by the next one.
            self._syncing = self._syncer.submit(partial(_fsync, self._file.descriptor()))

    def _write(self, file: AuditFile, line: Line, entry: Mapping[str, Any], room_bytes: int, of: Line | None) -> None:
        if of:
            entry = {**entry, "of": _number_of(of)}
        if self._unwritten:  # the disk was full: the outcomes of that many commands are missing
            entry = {**entry, "unwritten_before": self._unwritten}
        try:
            head = file.append(entry, room_bytes)
        except (OSError, RobotError) as error:
            line.set_exception(error)
            return
        self.failed, self._unwritten = "", 0
        if monotonic() - self._copied_at >= COPIED_EVERY_S:
            self._copy_head(head)
        line.set_result(head)

    def _copy_head(self, head: Head) -> None:
        if self._policy and head.seq != self._copied:
            _logger.warning("the head of the audit is %s", head.short)
        self._copied, self._copied_at = head.seq, monotonic()


def _number_of(line: Line | None) -> int:
    """Return the sequence number of a line; 0 until it is written."""
    return line.result().seq if line and line.done() and not line.exception() else 0


def _bounded(name: str, value: Any) -> Any:
    """Return a field as it is written: a long text or value is cut and marked as cut."""
    if isinstance(value, str):
        return value if len(value) <= _TEXT_CHARACTERS else f"{value[: _TEXT_CHARACTERS - 1]}…"
    if name != "value":
        return value
    text = json.dumps(value, default=str)
    return value if len(text) <= VALUE_CHARACTERS else {"cut_after": VALUE_CHARACTERS, "json": text[:VALUE_CHARACTERS]}


def _fsync(descriptor: int | None) -> None:
    if descriptor is None:
        return
    try:
        os.fsync(descriptor)
    except OSError as error:
        _logger.warning("the disk may not keep the audit: %s", error.strerror or error)
    finally:
        os.close(descriptor)
