"""What killed participants have left in shared memory is removed, and nothing else."""

from __future__ import annotations

import fcntl
import os
import time
from pathlib import Path

from ros2_mcp_bridge.ros.shared_memory import remove_dead


def segment(folder: Path, name: str, age_s: float) -> Path:
    """A segment and the file by whose lock its process shows that it lives."""
    path, lock = folder / name, folder / f"{name}_el"
    path.write_bytes(bytes(100))
    lock.touch()
    os.utime(lock, (time.time() - age_s,) * 2)
    return path


def test_only_old_segments_that_nobody_holds_are_removed(tmp_path: Path) -> None:
    dead = segment(tmp_path, "fastrtps_0123456789abcdef", 3600)
    alive = segment(tmp_path, "fastrtps_123456789abcdef0", 3600)
    young = segment(tmp_path, "fastrtps_23456789abcdef01", 1)
    port = segment(tmp_path, "fastrtps_port7411", 3600)
    other = segment(tmp_path, "mine_0123456789abcdef", 3600)
    with Path(f"{alive}_el").open() as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        remove_dead(tmp_path)
    assert not dead.exists() and not Path(f"{dead}_el").exists()
    assert all(one.exists() and Path(f"{one}_el").exists() for one in (alive, young, port, other))


def test_where_there_is_no_shared_memory_nothing_is_removed(tmp_path: Path) -> None:
    remove_dead(tmp_path / "absent")
