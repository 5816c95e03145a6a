"""A bridge that the tests of a file share, and peers that it knows."""

from __future__ import annotations

import itertools
import signal
import subprocess
import sys
from collections.abc import Iterator

import pytest

from support.bridge_client import Client, line

_numbers = itertools.count(1)


@pytest.fixture(scope="module")
def shared_bridge(ros_environment: dict[str, str]) -> Iterator[Client]:
    command = [sys.executable, "-m", "ros2_mcp_bridge"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=ros_environment) as process:
        client = Client(process)
        yield client
        client.close()
        assert process.returncode in (0, -signal.SIGALRM)  # which ends it where it is held up as it leaves


@pytest.fixture
def bridge(shared_bridge: Client) -> Client:
    """The bridge of all tests that do not end theirs; each test has names of its own."""
    shared_bridge.samples.clear()
    return shared_bridge


@pytest.fixture
def own_bridge(start) -> Client:
    """A bridge of this test's own, which it may end."""
    return Client(start("ros2_mcp_bridge"))


@pytest.fixture
def name() -> str:
    """A name that no other test has."""
    return f"/name{next(_numbers)}"


@pytest.fixture
def peer(start, request):
    """Start a peer: it and the test's bridge, if it has one, know each other when it is ready."""
    its_bridge = next((each for each in ("own_bridge", "bridge") if each in request.fixturenames), None)
    own = request.getfixturevalue(its_bridge) if its_bridge else None

    def start_peer(*arguments: str, knows: Client | None = own) -> subprocess.Popen[bytes]:
        env = {"KNOWS": knows.hello["node"][1:]} if knows else {}
        process = start("bridge_peer.py", *arguments, env=env)
        assert line(process) == "ready"
        return process

    return start_peer
