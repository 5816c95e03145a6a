"""What operating systems do differently with files: locks, bytes at a place, whose a file is.

Server and bridge use it. On Windows owners and bits of a file say nothing: there a user's folders are closed to others
by Windows itself, and nothing is checked here.
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
    # What is locked nobody else can read there, so that it is a byte far behind all that is written.
    _LOCKED_AT = 0x7FFF0000
else:
    import fcntl

    PLAIN = os.O_NOFOLLOW | os.O_CLOEXEC
    """For `os.open`: the file itself and no link, its bytes as they are, and not for our children."""

# Windows lets nobody take the place of a file that somebody reads: who reads one of ours does so within milliseconds.
_REPLACED_S = 1.0
_REPLACE_POLL_S = 0.01


def take_lock(descriptor: int) -> bool:
    """Takes the lock of an open file, if nobody has it; waits for nothing. It ends with `give_lock`, or the process.

    Raises `OSError` where the file cannot be locked at all.
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
    """Gives the lock of an open file back."""
    if sys.platform == "win32":
        os.lseek(descriptor, _LOCKED_AT, os.SEEK_SET)
        msvcrt.locking(descriptor, msvcrt.LK_UNLCK, 1)
    else:
        fcntl.flock(descriptor, fcntl.LOCK_UN)


def read_at(descriptor: int, most_bytes: int, offset: int) -> bytes:
    """Bytes of an open file from that place on."""
    if sys.platform == "win32":
        os.lseek(descriptor, offset, os.SEEK_SET)
        return os.read(descriptor, most_bytes)
    return os.pread(descriptor, most_bytes, offset)


def write_at(descriptor: int, data: bytes, offset: int) -> None:
    """Writes bytes into an open file at that place."""
    if sys.platform == "win32":
        os.lseek(descriptor, offset, os.SEEK_SET)
        os.write(descriptor, data)
    else:
        os.pwrite(descriptor, data, offset)


def replace(written: Path, target: Path) -> None:
    """Puts a file into the place of another one, whole."""
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
    """Whether it belongs to another user, who is not root."""
    return sys.platform != "win32" and found.st_uid not in (os.geteuid(), 0)


def others_can_write(found: os.stat_result) -> bool:
    """Whether others than its owner can write to it."""
    return sys.platform != "win32" and bool(found.st_mode & (stat.S_IWGRP | stat.S_IWOTH))
