"""Peers that give the server trouble, and what that may cost a process."""

from __future__ import annotations

import subprocess
from pathlib import Path

from support.processes import peer_command


class FaultyPeer:
    """A node of `faulty_peer`."""

    def __init__(self, environment: dict[str, str], arguments: tuple[str, ...]) -> None:
        self.process = subprocess.Popen(
            peer_command("faulty_peer", *arguments),
            env=environment,
            stdout=subprocess.PIPE,
            text=True,
        )

    def line(self) -> str:
        assert self.process.stdout
        return self.process.stdout.readline().strip()

    def end(self) -> None:
        """Wait until it has left."""
        self.process.communicate(timeout=30)


def count_threads_and_files(pid: int) -> dict[str, int]:
    """How many threads a process has, and how many files it has open."""
    return {what: len(list(Path(f"/proc/{pid}/{what}").iterdir())) for what in ("task", "fd")}


def parent_of(pid: int) -> int:
    """The process that started this one."""
    return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])
