"""Where the processes are that the tests start: the project's sources, and the peers beside this module."""

from __future__ import annotations

import os
import sys
from pathlib import Path

TESTS = Path(__file__).parents[1]
ROOT = TESTS.parent
SOURCES = ROOT / "src"
_PEERS = Path(__file__).with_name("peers")


def peer_command(name: str, *arguments: str) -> list[str]:
    """The command that runs a script of `support/peers`: `peer_command("memory_peer", "listen", "/x")`."""
    return [sys.executable, str(_PEERS / f"{name}.py"), *arguments]


def python_path(*before: str | Path) -> str:
    """PYTHONPATH for a process that needs the project, `support` and these folders."""
    folders = [*map(str, before), str(SOURCES), str(TESTS), os.environ.get("PYTHONPATH", "")]
    return os.pathsep.join(folder for folder in folders if folder)
