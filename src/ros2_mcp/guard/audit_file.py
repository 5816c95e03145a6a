"""Append to the audit: whole lines only, in one hash chain that continues across rotation, kill and restart.

Everything here blocks; `audit.py` calls it in a thread. Several servers may write to one audit: each locks the head
while it writes.
"""

from __future__ import annotations

import errno
import itertools
import json
import os
import shutil
import time
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from ros2_mcp.guard.chain import HEAD, Head, file_name, files_of, follows, line_of, parse_head
from ros2_mcp_common.files import PLAIN, give_lock, read_at, take_lock, write_at

FILE_BYTES = 64_000_000
"""The size at which a new file begins, in bytes: about 100,000 lines, which `verify` reads in a second."""
KEEP_BYTES = 1_000_000_000
"""The size of all files together, in bytes: over a million commands. The oldest files are deleted first."""
ROOM_BYTES = 262_144
"""The free space required on the disk before a command, in bytes, so that its outcome can be written as well. A line
has 3 kB at most."""
_HEAD_BYTES = 256
"""The fixed length of the head, in bytes: it is overwritten in place, which needs no space on a full disk."""
_LOCK_S = 0.1
"""The time limit for another server to release the head, in s. Writing a line takes 50 µs; a suspended server must not
block this one."""
_LOCK_POLL_S = 0.005
_FLAGS = os.O_CREAT | PLAIN


class AuditFile:
    """The files of one audit in `folder`, which must exist."""

    def __init__(self, folder: Path, *, file_bytes: int = FILE_BYTES, keep_bytes: int = KEEP_BYTES) -> None:
        self._folder = folder
        self._file_bytes = file_bytes
        self._keep_bytes = keep_bytes
        self._head_fd = -1
        self._fd = -1
        self._open_name = ""
        self._is_held = False
        self._free: int | None = None
        self.head = Head()

    def append(self, fields: Mapping[str, Any], room_bytes: int = 0) -> Head:
        """Append one line and return the head after it. After an error no part of the line remains in the file.

        Args:
            fields: the content of the line, as JSON values.
            room_bytes: the free space required on the disk, in bytes.

        Raises:
            OSError: if the line cannot be written, for example because the disk is full.
        """
        if not self._is_held:
            with self.held():
                return self.append(fields, room_bytes)
        if room_bytes and self._free_bytes() < room_bytes:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        if not self._open_name or self.head.bytes >= self._file_bytes:
            self._begin_file()
        self._write(fields)
        return self.head

    @contextmanager
    def held(self) -> Generator[None, None, None]:
        """Hold the lock in this context, so that no other server writes and each of several lines costs less.

        Raises as `append`.
        """
        with self._locked():
            self._catch_up()
            self._is_held, self._free = True, None
            try:
                yield
            finally:
                self._is_held = False

    def descriptor(self) -> int | None:
        """Return a duplicate of the descriptor of the current file, for a sync; None if nothing was written."""
        return os.dup(self._fd) if self._fd >= 0 else None

    def close(self) -> None:
        """Close the files."""
        for fd in (self._fd, self._head_fd):
            if fd >= 0:
                os.close(fd)
        self._fd = self._head_fd = -1
        self._open_name = ""

    # ── one line ───────────────────────────────────────────────────────────────────────────────────────────────────

    def _free_bytes(self) -> int:
        """Return the free space on the disk in bytes: queried once per lock, less the bytes written since."""
        if self._free is None:
            self._free = shutil.disk_usage(self._folder).free
        return self._free

    def _write(self, fields: Mapping[str, Any]) -> None:
        line, digest = line_of(self.head.seq + 1, self.head.hash, fields)
        written = 0
        try:
            while written < len(line):
                written += os.write(self._fd, line[written:])
        except OSError:
            if written:
                os.ftruncate(self._fd, self.head.bytes)
            raise
        if self._free is not None:
            self._free -= len(line)
        self._set_head(replace(self.head, seq=self.head.seq + 1, hash=digest, bytes=self.head.bytes + len(line)))

    def _set_head(self, head: Head) -> None:
        text = json.dumps({"seq": head.seq, "hash": head.hash, "file": head.file, "bytes": head.bytes})
        write_at(self._head_fd, text.ljust(_HEAD_BYTES - 1).encode() + b"\n", 0)
        self.head = head

    @contextmanager
    def _locked(self) -> Generator[None, None, None]:
        if self._head_fd < 0:
            self._head_fd = os.open(self._folder / HEAD, os.O_RDWR | _FLAGS, 0o600)
        deadline = time.monotonic() + _LOCK_S
        while not take_lock(self._head_fd):
            if time.monotonic() >= deadline:
                raise OSError(errno.EAGAIN, "another server holds the audit")
            time.sleep(_LOCK_POLL_S)
        try:
            yield
        finally:
            give_lock(self._head_fd)

    # ── after a start, or when another server has written ────────────────────────────────────────────────────────────

    def _catch_up(self) -> None:
        """Find the end of the chain, which another server may have moved or a kill may have left incomplete."""
        data = read_at(self._head_fd, _HEAD_BYTES, 0)
        found = parse_head(data)
        if self._open_name and found == self.head and self._is_in_place():
            return
        if found is None:
            found = self._rebuilt(had_head=bool(data.strip()))
        self._open(found)

    def _is_in_place(self) -> bool:
        """Return whether the open file is still the file with that name, and has the expected length."""
        try:
            named = (self._folder / self._open_name).lstat()
        except OSError:
            return False
        ours = os.fstat(self._fd)
        return (named.st_ino, named.st_dev) == (ours.st_ino, ours.st_dev) and ours.st_size == self.head.bytes

    def _rebuilt(self, had_head: bool) -> Head:
        """Rebuild the head from the last whole line, and begin a new file; without any files, return an empty head."""
        files = files_of(self._folder)
        if not files and not had_head:
            return Head()
        head = Head()
        for path in reversed(files):
            lines = path.read_bytes().splitlines(keepends=True)
            whole = [line for line in lines if line.endswith(b"\n")]
            if whole:
                try:
                    last = json.loads(whole[-1])
                    head = Head(int(last["seq"]), str(last["hash"]), path.name, sum(map(len, whole)))
                except (ValueError, KeyError, TypeError):
                    head = Head(int(path.stem[-12:]), "0" * 64)
                break
        self._begin_after(head, "the head was missing or damaged")
        return self.head

    def _open(self, head: Head) -> None:
        """Continue after this head. Whole lines that follow it in the chain (their server was killed before it wrote
        the head) are accepted; an incomplete line is cut off.
        """
        self.head = head
        if not head.file:
            return
        try:
            fd = os.open(self._folder / head.file, os.O_RDWR | os.O_APPEND | PLAIN)
        except OSError:
            self._begin_after(head, f"{head.file} was missing")
            return
        self._use(fd, head.file)
        size = os.fstat(fd).st_size
        if size < head.bytes:
            self._begin_after(head, f"{head.file} was {head.bytes - size} bytes shorter than it had been")
            return
        tail = read_at(fd, size - head.bytes, head.bytes) if size > head.bytes else b""
        for line in tail.splitlines(keepends=True):
            if not line.endswith(b"\n"):
                os.ftruncate(fd, self.head.bytes)
                break
            after = follows(line, self.head)
            if after is None:
                self._begin_after(self.head, f"{head.file} had lines that are not of this audit")
                return
            self._set_head(replace(after, file=head.file, bytes=self.head.bytes + len(line)))

    # ── files ──────────────────────────────────────────────────────────────────────────────────────────────────────

    def _begin_after(self, head: Head, why: str) -> None:
        """Begin a new file after damage. The damaged file is kept as evidence, and the first new line has the
        reason.
        """
        self.head = head
        self._new_file()
        self._write({"kind": "damage", "time": time.time(), "what": why})

    def _begin_file(self) -> None:
        """Begin the next file. Its first line names the last of the old lines that are deleted."""
        dropped = self._to_drop()
        is_first = not self.head.seq
        self._new_file()
        if is_first:
            return
        dropped_to = int(dropped[-1][1]) if dropped else 0
        self._write({"kind": "rotation", "time": time.time(), **({"dropped_to": dropped_to} if dropped else {})})
        for path, _ in dropped:
            path.unlink(missing_ok=True)

    def _new_file(self) -> None:
        name = file_name(self.head.seq + 1)
        fd = os.open(self._folder / name, os.O_RDWR | os.O_APPEND | _FLAGS, 0o600)
        if os.fstat(fd).st_size:  # lines of another writer, under the next number
            os.close(fd)
            (self._folder / name).rename(self._folder / f"{name}.foreign-{time.time_ns()}")
            fd = os.open(self._folder / name, os.O_RDWR | os.O_APPEND | os.O_EXCL | _FLAGS, 0o600)
        self._use(fd, name)
        self._set_head(replace(self.head, file=name, bytes=0))

    def _use(self, fd: int, name: str) -> None:
        if self._fd >= 0:
            os.close(self._fd)
        self._fd, self._open_name = fd, name

    def _to_drop(self) -> list[tuple[Path, int]]:
        """Return the oldest files beyond the size limit, each with the number of its last line."""
        files = files_of(self._folder)
        total = sum(path.stat().st_size for path in files)
        dropped: list[tuple[Path, int]] = []
        for path, following in itertools.pairwise(files):
            if total <= self._keep_bytes:
                break
            total -= path.stat().st_size
            dropped.append((path, int(following.stem[-12:]) - 1))
        return dropped
