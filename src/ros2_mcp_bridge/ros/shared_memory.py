"""Shared memory: removing what killed participants leave, and detecting that the port through which messages come has
been replaced.

A participant of Fast DDS has a segment of 0.55 MB, `/dev/shm/fastrtps_` and 16 hexadecimal digits. As long as its
process lives, that holds a lock on the file `…_el`, which it takes before it makes the segment. One that is killed
leaves both, and nobody else removes them: a container, whose shared memory has 64 MB, would be full after 120 kills.

Fast DDS lets a participant receive through `/dev/shm/fastrtps_portN`, where N is the UDP port that it would use
otherwise. Another process that takes the file for that of a dead process may replace it, most often soon after a killed
process was replaced. Then no message arrives any more, permanently.
"""

from __future__ import annotations

import fcntl
import os
import re
import time
from contextlib import suppress
from pathlib import Path

from ros2_mcp_bridge.ros.participants import ports_of

_LOCK_OF_A_PORT = re.compile(r"/dev/shm/fast\w+_port(\d+)_el")
_MAPPED_PORT = re.compile(r"/dev/shm/fast\w+_port(\d+)( \(deleted\))?$", re.MULTILINE)

_SEGMENT = re.compile(r"fast(?:rtps|dds)_[0-9a-f]{16}")
# The least age in s of a segment that is removed, since its creation: who was killed may have sent something last.
_KEPT_S = 60.0

_FOLDER = Path("/dev/shm")
# Two changes within a tick of the file system's clock (4 ms) look like one; this is far longer.
_TICK_NS = 1_000_000_000


def remove_dead(folder: Path = _FOLDER) -> None:
    """Remove the segments that killed participants of this user have left."""
    with suppress(OSError):  # another one may do the same
        for path in [path for path in folder.iterdir() if _SEGMENT.fullmatch(path.name)]:
            with suppress(OSError), path.with_name(f"{path.name}_el").open("rb") as lock:
                about = os.fstat(lock.fileno())
                if about.st_uid == os.geteuid() and time.time() - about.st_mtime > _KEPT_S:
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    path.unlink()
                    Path(lock.name).unlink()


def newest_change() -> int | None:
    """Return when a file of shared memory was last created or removed, in ns by the file system; None
    if a change may be unseen.
    """
    if not _FOLDER.exists():
        return None
    changed_ns = _FOLDER.stat().st_mtime_ns
    return changed_ns if abs(time.time_ns() - changed_ns) > _TICK_NS else None


def is_lost(domain_id: int) -> bool:
    """Return whether this process receives at a port of the domain whose file has been replaced or removed."""
    maps = Path("/proc/self/maps")
    if not maps.exists():
        return False
    found: list[tuple[str, str]] = _MAPPED_PORT.findall(maps.read_text())
    removed = {port for port, deleted in found if deleted} - {port for port, deleted in found if not deleted}
    return any(int(port) in ports_of(domain_id) for port in removed & _own_ports())


def _own_ports() -> set[str]:
    """Return the ports at which this process receives: it keeps their lock files open."""
    ports: set[str] = set()
    for descriptor in Path("/proc/self/fd").iterdir():
        with suppress(OSError):  # the descriptor of the listing itself is closed by now
            lock = _LOCK_OF_A_PORT.match(str(descriptor.readlink()))
            if lock:
                ports.add(lock.group(1))
    return ports
