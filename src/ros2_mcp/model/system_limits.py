"""Recognise errors that mean that a limit of the operating system is reached, whatever raised them."""

from __future__ import annotations

import errno
import re
import sys
from collections.abc import Iterator

from ros2_mcp.model.errors import RobotError, SystemLimit

if sys.platform != "win32":
    import resource

_OF_RUST = re.compile(r"\(os error (\d+)\)")
"""The notation of system errors in libraries written in Rust, such as the sandbox."""
_FILES = (errno.EMFILE, errno.ENFILE)
_MEMORY = "This machine has no more memory for this server."
_DISK = "The disk is full."
_WORDS = {errno.ENOMEM: _MEMORY, errno.ENOSPC: _DISK, errno.EDQUOT: "The disk quota of this server's user is used up."}
_FILES_HINT = (
    "Stop recordings, playbacks or programs, or disconnect clients; or start the server with a higher limit "
    "(ulimit -n, LimitNOFILE= of systemd)."
)


def system_limit(error: BaseException) -> SystemLimit | None:
    """Return the system limit behind an error; None if there is none.

    An error that was raised on purpose explains itself, except when no file can be opened: then each place that opens a
    file blames the file.
    """
    on_purpose = isinstance(error, RobotError)
    for number in _numbers(error):
        if number == errno.EMFILE:
            return SystemLimit(
                f"This server cannot open another file: it has as many as it may have{_most()}.", _FILES_HINT
            )
        if number == errno.ENFILE:
            return SystemLimit("This machine cannot open another file: it has as many as it may have.", _FILES_HINT)
        if number in _WORDS and not on_purpose:
            return SystemLimit(_WORDS[number])
    return None


def _numbers(error: BaseException | None) -> Iterator[int]:
    """Yield the system error numbers of an error, and of the errors from which it was raised."""
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        seen.add(id(error))
        if isinstance(error, OSError) and error.errno is not None:
            yield error.errno
        elif found := _OF_RUST.search(str(error)):
            yield int(found[1])
        error = error.__cause__ or error.__context__


def _most() -> str:
    """Return the limit of open files of this process, in parentheses; empty if it is not known."""
    if sys.platform == "win32":
        return ""
    return f" ({resource.getrlimit(resource.RLIMIT_NOFILE)[0]})"
