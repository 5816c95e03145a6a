"""The real server over real stdio, and independent nodes on both sides of its relays."""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Callable

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")


PATIENCE_S = 20.0


class Peer:
    """One process of `relay_peer`."""

    def __init__(self, role: str, process: subprocess.Popen[bytes]) -> None:
        self.process = process
        self.node = f"/relay_peer_{role}_{process.pid}"

    def ready(self) -> Peer:
        """Wait until it has met a publisher or subscriber of its topic, or has logged what it should."""
        assert self.line() == "ready"
        return self

    def line(self) -> object:
        """What it says next."""
        assert self.process.stdout
        return json.loads(self.process.stdout.readline())

    def tell(self, text: str = "") -> None:
        """Send it a line."""
        assert self.process.stdin
        self.process.stdin.write(f"{text}\n".encode())
        self.process.stdin.flush()

    def heard(self) -> list[tuple[float, float]]:
        """What a listener that is ready heard since it was last asked: time and number of each message."""
        self.tell()
        return [tuple(entry) for entry in self.line()]  # type: ignore[attr-defined]

    def numbers(self, count: int) -> list[float]:
        """The numbers that it heard since it was last asked, as soon as they are so many."""
        return [number for _, number in self.until(lambda heard: len(heard) >= count)]

    def until(self, is_enough: Callable[[list[tuple[float, float]]], bool]) -> list[tuple[float, float]]:
        """All that it heard since it was last asked, as soon as that is enough, or patience has ended."""
        deadline, heard = time.monotonic() + PATIENCE_S, self.heard()
        while not is_enough(heard) and time.monotonic() < deadline:
            time.sleep(0.02)
            heard += self.heard()
        return heard


@pytest.fixture
def peer(start) -> Callable[..., Peer]:
    """Start an independent node: `peer("talk", "/topic", "String", "RELIABLE", "200", "1000")`."""
    return lambda role, *arguments: Peer(role, start("relay_peer.py", role, *arguments))
