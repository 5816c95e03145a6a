"""Simulates a small computer: the measured server and its floor get a part of one core, each in a cgroup of its own.

The client and the observed nodes keep the machine's own speed: they stand for other machines.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from pathlib import Path

# Short, so that a process is slow without long pauses: the kernel's default of 100 ms would be visible in each answer.
_PERIOD_US = 10_000
_ENTER = 'echo $$ >"$0/cgroup.procs" && exec "$@"'
_numbers = itertools.count(1)
_groups: list[Path] = []
_share: list[float] = []


@contextmanager
def slowed(share: float) -> Generator[None]:
    """Limit each process that `command` starts meanwhile, with its children, to `share` of one core.

    Needs the right to create cgroups, as root has it. Raises `OSError` without it.
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
    """Return the command that starts these words, slowed down inside `slowed`; the process keeps its id."""
    if not _share:
        return list(words)
    group = _new_group(round(_share[0] * _PERIOD_US))
    return ["sh", "-c", _ENTER, str(group), *words]


def _new_group(quota_us: int) -> Path:
    """Create a cgroup with this CPU time in each period, for either version of cgroups."""
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
