"""The real server over real stdio, and independent nodes on both sides of its relays."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

sys.path.insert(0, str(Path(__file__).parent.parent / "server"))  # the client of the server's tests

from agent import Agent, agent_for


@pytest.fixture(scope="module")
def agent(ros_environment: dict[str, str]) -> Iterator[Agent]:
    """A client of a server that the tests of a file share."""
    with agent_for(ros_environment, "--tools", "all") as client:
        yield client


@pytest.fixture
def start_agent(ros_environment: dict[str, str]) -> Iterator[Callable[..., Agent]]:
    """Start a server of this test's own: `start_agent("--tools", "all")`."""
    with ExitStack() as running:

        def begin(*options: str) -> Agent:
            return running.enter_context(agent_for(ros_environment, *options))

        yield begin


class Peer:
    """One process of relay_peer.py."""

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


@pytest.fixture
def peer(start) -> Callable[..., Peer]:
    """Start an independent node: `peer("talk", "/topic", "String", "RELIABLE", "200", "1000")`."""
    return lambda role, *arguments: Peer(role, start("relay/relay_peer.py", role, *arguments))
