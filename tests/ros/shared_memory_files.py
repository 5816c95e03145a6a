"""What killed processes leave in /dev/shm: with enough of it, Fast DDS complains on stdout and messages stay away."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

FOLDER = Path("/dev/shm")
PATTERNS = ("fastrtps_*", "fastdds_*", "sem.fastrtps_*", "sem.fastdds_*")
_NAME = re.compile(r"/dev/shm/(\S+)")


def remove_orphans() -> None:
    """Remove the files of Fast DDS that are ours and that no process has open or mapped."""
    used = set(_used())
    for pattern in PATTERNS:
        for file in FOLDER.glob(pattern):
            with suppress(FileNotFoundError):
                if file.name not in used and file.stat().st_uid == os.getuid():
                    file.unlink()


def _used() -> Iterator[str]:
    for process in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):  # it has ended, or is somebody else's
            yield from _NAME.findall((process / "maps").read_text())
            for descriptor in (process / "fd").iterdir():
                with suppress(OSError):
                    yield from _NAME.findall(str(descriptor.readlink()))
