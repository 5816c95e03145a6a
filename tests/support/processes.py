"""The processes that the tests start: where they are, and one that runs while a block does."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

TESTS = Path(__file__).parents[1]
ROOT = TESTS.parent
SOURCES = ROOT / "src"
SHARED = Path("/tmp")
"""For locks and builds that all runs on this machine share, wherever each keeps its own temporary files."""
END_S = 10.0
"""A node leaves within a second; a busy machine stretches that."""
_PEERS = Path(__file__).with_name("peers")


def peer_command(name: str, *arguments: str) -> list[str]:
    """The command that runs a script of `support/peers`: `peer_command("memory_peer", "listen", "/x")`."""
    return [sys.executable, str(_PEERS / f"{name}.py"), *arguments]


def python_path(*before: str | Path) -> str:
    """PYTHONPATH for a process that needs the project, `support` and these folders."""
    folders = [*map(str, before), str(SOURCES), str(TESTS), os.environ.get("PYTHONPATH", "")]
    return os.pathsep.join(folder for folder in folders if folder)


@contextmanager
def running(environment: dict[str, str], *command: str, sigterm: bool = True) -> Generator[subprocess.Popen[str]]:
    """A process that has written its first line, which says that it is ready; stdin and stdout are pipes.

    It ends with its input, and by SIGTERM unless that is not wanted; one that does not is killed: a peer that stays is
    no fault of the server under test.
    """
    pipe = subprocess.PIPE
    process = subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, env=environment)
    try:
        assert process.stdout and process.stdout.readline(), f"{command} died"
        yield process
    finally:
        if sigterm:
            process.terminate()
        try:
            process.communicate(timeout=END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
