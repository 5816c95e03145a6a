"""ROS domains for tests: no two blocks that run at the same time on this machine share one, in whatever process."""

from __future__ import annotations

import fcntl
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

DOMAINS_OF_A_BLOCK = 3
LAST_DOMAIN = 101
"""Linux gives the ports that DDS would use in higher domains to anybody's sockets."""


@contextmanager
def reserved_domains() -> Iterator[int]:
    """The first of three neighbouring domain ids that are the block's alone.

    They are those that have been free for longest: what was killed in a domain leaves shared memory behind, in which a
    newcomer may be deaf.
    """
    folder = Path(tempfile.gettempdir())
    firsts = range(1, LAST_DOMAIN - DOMAINS_OF_A_BLOCK + 2, DOMAINS_OF_A_BLOCK)
    locks = {folder / f"ros2-mcp-test-domain-{first}.lock": first for first in firsts}
    for path in sorted(locks, key=_last_used):
        with path.open("a") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                continue
            try:
                yield locks[path]
            finally:
                os.utime(path)
            return
    raise RuntimeError(f"All {len(locks)} domains for tests are taken: see the locks in {folder}.")


def _last_used(path: Path) -> float:
    return path.stat().st_mtime if path.exists() else 0.0
