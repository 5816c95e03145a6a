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


@pytest.fixture(scope="session")
def agent(ros_environment: dict[str, str]) -> Iterator[Agent]:
    """A client of a server that all tests share."""
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

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        self.process = process
        assert self.line() == "ready"

    def line(self) -> object:
        """What it says next."""
        assert self.process.stdout
        return json.loads(self.process.stdout.readline())

    def heard(self) -> list[tuple[float, float]]:
        """What a listener heard since it was last asked: time and number of each message."""
        assert self.process.stdin
        self.process.stdin.write(b"\n")
        self.process.stdin.flush()
        return [tuple(entry) for entry in self.line()]  # type: ignore[attr-defined]


@pytest.fixture
def peer(start) -> Callable[..., Peer]:
    """Start an independent node: `peer("talk", "/topic", "String", "RELIABLE", "200", "1000")`."""
    return lambda *arguments: Peer(start("relay/relay_peer.py", *arguments))
