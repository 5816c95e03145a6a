"""Whether the shared memory that messages come through is still the one that others find.

Fast DDS lets a participant receive through `/dev/shm/fastrtps_portN`, where N is the UDP port that it would use for the
same. A process that takes it for a dead one's may put a new file in its place, most often soon after a killed process
was replaced; then nothing arrives any more, for good.
"""

from __future__ import annotations

import re
import time
from contextlib import suppress
from pathlib import Path

from ros2_mcp_bridge.ros.participants import ports_of

_LOCK_OF_A_PORT = re.compile(r"/dev/shm/fast\w+_port(\d+)_el")
_MAPPED_PORT = re.compile(r"/dev/shm/fast\w+_port(\d+)( \(deleted\))?$", re.MULTILINE)

_FOLDER = Path("/dev/shm")
# Two changes within a tick of the file system's clock (4 ms) look like one. Chosen, with much room.
_TICK_NS = 1_000_000_000


def newest_change() -> int | None:
    """When a file of shared memory last came or went, by the file system; None where that may change unseen."""
    if not _FOLDER.exists():
        return None
    changed_ns = _FOLDER.stat().st_mtime_ns
    return changed_ns if abs(time.time_ns() - changed_ns) > _TICK_NS else None


def is_lost(domain_id: int) -> bool:
    """Whether this process waits at a port of a domain whose file has been replaced or removed."""
    maps = Path("/proc/self/maps")
    if not maps.exists():
        return False
    found: list[tuple[str, str]] = _MAPPED_PORT.findall(maps.read_text())
    removed = {port for port, deleted in found if deleted} - {port for port, deleted in found if not deleted}
    return any(int(port) in ports_of(domain_id) for port in removed & _own_ports())


def _own_ports() -> set[str]:
    """Who listens at a port keeps its lock file open."""
    ports: set[str] = set()
    for descriptor in Path("/proc/self/fd").iterdir():
        with suppress(OSError):  # that of the listing itself is closed by now
            lock = _LOCK_OF_A_PORT.match(str(descriptor.readlink()))
            if lock:
                ports.add(lock.group(1))
    return ports
