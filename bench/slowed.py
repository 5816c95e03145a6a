"""A small computer: what is measured, and its floor, get a part of one core, each in a cgroup of its own.

The client and the nodes that are looked at keep the machine's own speed: they stand for what is elsewhere.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from pathlib import Path

# Short, so that a process is slow and not stopped for long: the kernel's own of 100 ms would be seen in each answer.
_PERIOD_US = 10_000
_ENTER = 'echo $$ >"$0/cgroup.procs" && exec "$@"'
_numbers = itertools.count(1)
_groups: list[Path] = []
_share: list[float] = []


@contextmanager
def slowed(share: float) -> Generator[None]:
    """While it is entered, each process that `command` starts may use so much of one core, with its children.

    Needs the right to make cgroups, as root has it. Raises `OSError` without it.
    """
    _share.append(share)
    try:
        yield
    finally:
        _share.clear()
        for group in _groups:
            group.rmdir()
        _groups.clear()


def command(words: Sequence[str]) -> list[str]:
    """The command that starts these words, slowed where that was asked for; the process keeps its number."""
    if not _share:
        return list(words)
    group = _new_group(round(_share[0] * _PERIOD_US))
    return ["sh", "-c", _ENTER, str(group), *words]


def _new_group(quota_us: int) -> Path:
    """A cgroup with that much time in each period, of either version of cgroups."""
    first = Path("/sys/fs/cgroup/cpu")
    name = f"ros2-mcp-bench-{os.getpid()}-{next(_numbers)}"
    if first.is_dir():
        group = first / name
        group.mkdir()
        (group / "cpu.cfs_period_us").write_text(str(_PERIOD_US))
        (group / "cpu.cfs_quota_us").write_text(str(quota_us))
    else:
        group = Path("/sys/fs/cgroup") / name
        group.mkdir()
        (group / "cpu.max").write_text(f"{quota_us} {_PERIOD_US}")
    _groups.append(group)
    return group
