"""A container of the image without an engine: its entry point as the first process of a namespace."""

from __future__ import annotations

import os
import subprocess
from contextlib import suppress
from functools import cache
from pathlib import Path

from support.source import ROOT

ENTRYPOINT = str(ROOT / "deploy/docker/entrypoint.sh")
_UNSHARE = ["unshare", *(() if os.geteuid() == 0 else ("--user", "--map-root-user"))]
CONTAINER = [*_UNSHARE, "--pid", "--fork", "--kill-child", "--mount-proc"]
"""What runs a command as the first process of a namespace, with which the kernel ends all others."""
WHERE_NONE = "this user or machine may not make namespaces of processes"


@cache
def there_are_containers() -> bool:
    """Whether this machine lets us have such namespaces."""
    try:
        return subprocess.run([*CONTAINER, "true"], capture_output=True, check=False).returncode == 0
    except FileNotFoundError:
        return False


def children(pid: int) -> list[int]:
    """The processes that a process has started, by any of its threads, in the order of their numbers."""
    found: list[int] = []
    tasks: list[Path] = []
    with suppress(FileNotFoundError, ProcessLookupError):  # the process has ended meanwhile
        tasks += Path(f"/proc/{pid}/task").iterdir()
    for task in tasks:
        with suppress(FileNotFoundError, ProcessLookupError):  # so has the thread: its children are another one's then
            found += map(int, (task / "children").read_text("ascii").split())
    return sorted(found)
