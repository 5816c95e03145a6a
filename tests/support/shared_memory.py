"""What Fast DDS leaves in shared memory: the segment of each participant, and the ports through which it is told of it.

A participant's segment is a file `fastrtps_<16 hexadecimal digits>`; as long as its process lives, that holds a lock
(flock) on the file `…_el`, which it takes before it makes the segment. A port is `fastrtps_port<number>`; its reader
holds a lock on `…_el`; `sem.…_mutex` guards its opening. Whoever leaves in order removes its segment, its locks, and
the ports that nobody else has open. What was killed does not; and each port of those whom it had told something stays,
too, whoever leaves it last, since a port counts those who have it open. A newcomer that gets such a port waits up to a
second for its dead listeners.
"""

from __future__ import annotations

import os
import re
from collections.abc import Collection, Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from support.own_processes import listed

FOLDER = Path("/dev/shm")
FIRST_PORT, PORTS_OF_A_DOMAIN = 7400, 250
_SEGMENT = re.compile(r"fast(?:rtps|dds)_[0-9a-f]{16}")
_OF_A_PORT = re.compile(r"(?:sem\.)?(fast(?:rtps|dds)_port(\d+))(?:_el|_sl|_mutex)?")
_GUID = re.compile(rb"RTPS\x02.\x01\x0f\x01\x0f..(..)", re.DOTALL)
"""Begins a message of Fast DDS (vendor 1.15): its GUID has the host's id, then the lower half of the process id."""


class Segment(NamedTuple):
    """A participant's, of a process that has ended: since when (s since 1970) it was there, and the lower half of the
    process id, if it ever said anything.
    """

    name: str
    at: float
    process: int | None


def dead_segments() -> list[Segment]:
    """The segments of all processes of this machine that have ended without removing them."""
    locked, dead = _locked(), list[Segment]()
    for path in FOLDER.iterdir():
        if _SEGMENT.fullmatch(path.name):
            with suppress(FileNotFoundError):  # it is just being removed
                lock = path.with_name(f"{path.name}_el").stat()
                if lock.st_ino not in locked:
                    dead.append(Segment(path.name, lock.st_mtime, _process(path)))
    return dead


def remove_segment(segment: Segment) -> None:
    """Remove a dead segment; those who still have it open keep it until they end."""
    for name in (segment.name, f"{segment.name}_el"):
        (FOLDER / name).unlink(missing_ok=True)


def holders(domains: Collection[int]) -> dict[int, list[str]]:
    """The processes that have ports of these domains open, and which."""
    names = {match[1] for _, match in _of_ports(domains)}
    found: dict[int, list[str]] = {}
    for pid in sorted(listed()) if names else ():
        with suppress(OSError):
            maps = Path(f"/proc/{pid}/maps").read_text()
            if opened := [name for name in sorted(names) if f"{FOLDER / name}\n" in maps]:
                found[pid] = opened
    return found


def remove_ports(domains: Collection[int]) -> None:
    """Remove the ports of domains in which nobody is."""
    for path, _ in _of_ports(domains):
        path.unlink(missing_ok=True)


def _of_ports(domains: Collection[int]) -> Iterator[tuple[Path, re.Match[str]]]:
    for path in FOLDER.iterdir():
        match = _OF_A_PORT.fullmatch(path.name)
        if match and (int(match[2]) - FIRST_PORT) // PORTS_OF_A_DOMAIN in domains:
            yield path, match


def _locked() -> set[int]:
    """The inodes in shared memory that somebody has locked; asking so locks nothing ourselves."""
    device = FOLDER.stat().st_dev
    at = f"{os.major(device):02x}:{os.minor(device):02x}"
    return set(map(int, re.findall(rf" {at}:(\d+) ", Path("/proc/locks").read_text())))


def _process(segment: Path) -> int | None:
    begun = _GUID.search(segment.read_bytes())
    return int.from_bytes(begun[1], "little") if begun else None
