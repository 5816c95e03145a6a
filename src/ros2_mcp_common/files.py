"""File operations that differ between operating systems: locks, reading and writing at an offset, ownership.

Server and bridge use it. On Windows, owners and permission bits say nothing: Windows itself protects a user's folders,
and nothing is checked here.
"""

from __future__ import annotations

import os
import stat
import sys
import time
from pathlib import Path

if sys.platform == "win32":
    import msvcrt

    PLAIN = os.O_BINARY | os.O_NOINHERIT
    # On Windows no other process can read a locked byte, so a byte far behind all content is locked.
    _LOCKED_AT = 0x7FFF0000
else:
    import fcntl

    PLAIN = os.O_NOFOLLOW | os.O_CLOEXEC
    """For `os.open`: the file itself and no link, its bytes as they are, and not for our children."""

# Windows does not replace a file that is open for reading; our own readers close a file within milliseconds.
_REPLACED_S = 1.0
_REPLACE_POLL_S = 0.01


def take_lock(descriptor: int) -> bool:
    """Take the lock of an open file without waiting; return whether it was free.

    `give_lock` or the end of the process releases it.

    Raises:
        OSError: if the file cannot be locked at all.
    """
    try:
        if sys.platform == "win32":
            os.lseek(descriptor, _LOCKED_AT, os.SEEK_SET)
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        else:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        return False
    return True


def give_lock(descriptor: int) -> None:
    """Release the lock of an open file."""
    if sys.platform == "win32":
        os.lseek(descriptor, _LOCKED_AT, os.SEEK_SET)
        msvcrt.locking(descriptor, msvcrt.LK_UNLCK, 1)
    else:
        fcntl.flock(descriptor, fcntl.LOCK_UN)


def read_at(descriptor: int, most_bytes: int, offset: int) -> bytes:
    """Read up to `most_bytes` bytes of an open file from that offset on."""
    if sys.platform == "win32":
        os.lseek(descriptor, offset, os.SEEK_SET)
        return os.read(descriptor, most_bytes)
    return os.pread(descriptor, most_bytes, offset)


def write_at(descriptor: int, data: bytes, offset: int) -> None:
    """Write bytes into an open file at that offset."""
    if sys.platform == "win32":
        os.lseek(descriptor, offset, os.SEEK_SET)
        os.write(descriptor, data)
    else:
        os.pwrite(descriptor, data, offset)


def replace(written: Path, target: Path) -> None:
    """Move a written file to the place of another file, atomically."""
    deadline = time.monotonic() + _REPLACED_S
    while True:
        try:
            written.replace(target)
            return
        except PermissionError:
            if sys.platform != "win32" or time.monotonic() >= deadline:
                raise
        time.sleep(_REPLACE_POLL_S)


def is_of_others(found: os.stat_result) -> bool:
    """Return whether the file belongs to another user, except root."""
    return sys.platform != "win32" and found.st_uid not in (os.geteuid(), 0)


def others_can_write(found: os.stat_result) -> bool:
    """Return whether users other than the owner can write to the file."""
    return sys.platform != "win32" and bool(found.st_mode & (stat.S_IWGRP | stat.S_IWOTH))
