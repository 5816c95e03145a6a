"""What a process leaves behind that is killed while it writes: locked ports of Fast DDS's shared memory.

`locking_peer.py PID` locks the ports on which that process receives data, says how many they are, and waits to be
killed. `locking_peer.py PID give-up` declares them faulty instead, as a watchdog of Fast DDS does with the port of a
thread that was not run for a second: both sides then open another one, and what is sent meanwhile is lost. It knows the
memory of Fast DDS 2.14.
"""

from __future__ import annotations

import ctypes
import mmap
import re
import struct
import sys
from contextlib import suppress
from pathlib import Path

LOCK_OF_A_PORT = re.compile(r"(/dev/shm/fast\w+_port)(\d+)_el$")
"""Not of one that was deleted: of a port that was given up before, and opened anew by both sides at once."""
HEALTHY_CHECK_MS = 1000
"""Follows a port's number, and the number of its listeners, where its memory describes it (`PortNode`)."""
MUTEX_AFTER = 20_572
"""Bytes from a port's number to its mutex: in between is a condition with 512 semaphores."""
FLAGS_AFTER = 24
"""Bytes from a port's number to its flags, the lowest of which says that it is no faulty one."""
SHARED_BY_PROCESSES = 128
"""The kind of a mutex, 16 bytes after its beginning."""


def ports(pid: int) -> dict[int, Path]:
    """The number and the file of each port on which a process receives data: they are odd, and it keeps their lock."""
    found: dict[int, Path] = {}
    for descriptor in Path(f"/proc/{pid}/fd").iterdir():
        with suppress(OSError):  # one that was closed meanwhile
            port = LOCK_OF_A_PORT.match(str(descriptor.readlink()))
            if port and int(port[2]) % 2:
                found[int(port[2])] = Path(f"{port[1]}{port[2]}")
    return found


def number_in(memory: mmap.mmap, number: int) -> int:
    """Where the memory of a port has its number."""
    at = -1
    while (at := memory.find(struct.pack("<I", number), at + 1)) >= 0:
        listeners, check_ms = struct.unpack_from("<II", memory, at + 4)
        if listeners and check_ms == HEALTHY_CHECK_MS:
            return at
    raise AssertionError(f"the memory of port {number} is another one than that of Fast DDS 2.14")


def mutex_in(memory: mmap.mmap, number: int) -> int:
    """Where the mutex of a port is."""
    mutex = number_in(memory, number) + MUTEX_AFTER
    assert struct.unpack_from("<I", memory, mutex + 16) == (SHARED_BY_PROCESSES,)
    return mutex


def opened(path: Path) -> mmap.mmap:
    """The memory of a port."""
    with path.open("r+b") as file:
        return mmap.mmap(file.fileno(), 0)


def give_up(number: int, path: Path) -> None:
    """Declare a port faulty."""
    memory = opened(path)
    at = number_in(memory, number) + FLAGS_AFTER
    (flags,) = struct.unpack_from("<I", memory, at)
    assert flags & 1, f"port {number} is faulty already, or its memory another one than that of Fast DDS 2.14"
    struct.pack_into("<I", memory, at, flags & ~1)


def lock(number: int, path: Path) -> mmap.mmap:
    """Lock a port; the memory has to be kept."""
    memory = opened(path)
    mutex = ctypes.addressof(ctypes.c_char.from_buffer(memory, mutex_in(memory, number)))
    assert ctypes.CDLL(None).pthread_mutex_lock(ctypes.c_void_p(mutex)) == 0
    return memory


def main() -> None:
    found, gives_up = ports(int(sys.argv[1])), "give-up" in sys.argv
    kept = [(give_up if gives_up else lock)(number, path) for number, path in found.items()]
    print(len(kept), flush=True)
    sys.stdin.read()


if __name__ == "__main__":
    main()
