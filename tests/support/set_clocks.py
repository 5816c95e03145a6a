"""Wall clocks that are set while processes run, each process's by itself: this machine's own stays as it is."""

from __future__ import annotations

import mmap
import os
import struct
import subprocess
from pathlib import Path

import pytest

PLACES = {"server": 0, "bridge": 1, "robot": 2}
"""Of whom the clock is set. As in `set_clocks.c`, where the bridge and its stoppers are told from their server."""
_ROOM = 8


class SetClocks:
    """The clocks of the processes that are started with `of(who)`; all are right until they are set."""

    def __init__(self, folder: Path, library: Path) -> None:
        self._library = library
        self._path = folder / "clocks"
        self._path.write_bytes(bytes(8 * _ROOM))
        with self._path.open("r+b") as file:
            self._offsets = mmap.mmap(file.fileno(), 8 * _ROOM)

    def of(self, who: str) -> dict[str, str]:
        """The variables with which a process has the clock of a server (with its bridge) or of a robot."""
        return {"LD_PRELOAD": str(self._library), "CLOCKS_FILE": str(self._path), "CLOCKS_PLACE": str(PLACES[who])}

    def set(self, ahead_s: float, *whose: str) -> None:
        """From now on these clocks are so far ahead of this machine's, or behind it."""
        for who in whose:
            struct.pack_into("<q", self._offsets, 8 * PLACES[who], int(ahead_s * 1e9))


def built(folder: Path) -> Path:
    """The library; skips where it cannot be made."""
    library = folder / "set_clocks.so"
    compiler = os.environ.get("CC", "gcc")
    source = Path(__file__).with_name("set_clocks.c")
    try:
        subprocess.run(
            [compiler, "-O2", "-Wall", "-Werror", "-shared", "-fPIC", "-o", str(library), str(source), "-ldl"],
            check=True,
        )
    except FileNotFoundError:
        pytest.skip("needs a C compiler (apt-get install gcc)")
    return library
