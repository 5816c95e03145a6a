"""A /dev/shm of a test's own, which is small and can be filled: in a mount namespace, so that nobody else's is."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

ROOM_BYTES = 64 * 1024 * 1024
"""What a container has by default (docker run --shm-size)."""
_MOUNTS = f"mount -t tmpfs -o size={ROOM_BYTES} tmpfs /dev/shm && echo ready && read -r _"
_FILLER = "filler"


class SharedMemory:
    """The namespace, as long as the process that holds it lives."""

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        self._process = process
        self.folder = Path("/proc", str(process.pid), "root", "dev", "shm")

    def command(self, *command: str) -> list[str]:
        """The command, run in it; its process has the id that is seen from outside."""
        return ["nsenter", f"--mount=/proc/{self._process.pid}/ns/mnt", f"--wd={os.getcwd()}", *command]  # noqa: PTH109

    def fill(self) -> None:
        """From now on there is no room in it."""
        with (self.folder / _FILLER).open("ab", buffering=0) as filler, contextlib.suppress(OSError):
            while True:
                filler.write(bytes(65536))

    def empty(self) -> None:
        """There is room again."""
        (self.folder / _FILLER).unlink()

    def left(self) -> list[str]:
        """What is in it."""
        return sorted(path.name for path in self.folder.iterdir() if path.name != _FILLER)


@contextmanager
def shared_memory_of_its_own() -> Iterator[SharedMemory]:
    """It, for the time of a block; skips where no namespace can be made."""
    if not (shutil.which("unshare") and shutil.which("nsenter")):
        pytest.skip("needs unshare and nsenter (apt-get install util-linux)")
    pipe = subprocess.PIPE
    with subprocess.Popen(["unshare", "--mount", "sh", "-c", _MOUNTS], stdin=pipe, stdout=pipe) as process:
        try:
            assert process.stdout
            if process.stdout.readline() != b"ready\n":
                pytest.skip("no mount namespace may be made here")
            yield SharedMemory(process)
        finally:
            process.kill()
