"""The real server over real stdio, in processes of its own, and an independent ROS node on the other side."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")

sys.path.insert(0, str(Path(__file__).parent))  # the tests import their neighbours

from agent import Agent, agent_for
from raw_server import RawServer


class PeerProcess:
    """The commands of `server_peer.py`, each a method: `peer.listen(topic="/said", kind="std_msgs/msg/String")`."""

    def __init__(self, environment: dict[str, str]) -> None:
        script = Path(__file__).parent / "server_peer.py"
        self._process = subprocess.Popen(
            [sys.executable, str(script)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment
        )
        assert self._answer() == "ready"

    def __getattr__(self, command: str) -> Callable[..., Any]:
        def ask(**arguments: Any) -> Any:
            assert self._process.stdin
            self._process.stdin.write(json.dumps([command, arguments]) + "\n")
            self._process.stdin.flush()
            return self._answer()

        return ask

    def end(self) -> None:
        """Let it go, and see that it went."""
        self._process.communicate(timeout=20)
        assert self._process.returncode == 0

    def kill(self) -> None:
        """End it without its saying goodbye to ROS."""
        self._process.kill()
        self._process.wait(5)

    def _answer(self) -> Any:
        assert self._process.stdout
        line = self._process.stdout.readline()
        assert line, "the peer died"
        return json.loads(line)


@pytest.fixture(scope="module")
def agent(ros_environment: dict[str, str]) -> Iterator[Agent]:
    """A client of a server that all tests share."""
    with agent_for(ros_environment, "--tools", "all") as client:
        yield client


@pytest.fixture(scope="module")
def peer(ros_environment: dict[str, str], agent: Agent) -> Iterator[PeerProcess]:
    """An independent node that all tests share, discovered."""
    process = PeerProcess(ros_environment)
    process.offer(topic="/peer_is_here", kind="std_msgs/msg/String", seed=1)
    agent.knows("/peer_is_here")
    process.forget(topic="/peer_is_here")
    yield process
    process.end()


@pytest.fixture
def start_agent(ros_environment: dict[str, str]) -> Iterator[Callable[..., Agent]]:
    """Start a server of this test's own: `start_agent("--read-only", ROS2_MCP_TOOLS="core")`."""
    with ExitStack() as running:

        def begin(*options: str, **changed: str) -> Agent:
            return running.enter_context(agent_for({**ros_environment, **changed}, *options))

        yield begin


@pytest.fixture
def start_raw(ros_environment: dict[str, str]) -> Iterator[Callable[..., RawServer]]:
    """Start a server whose lines the test writes and reads itself."""
    servers: list[RawServer] = []

    def begin(*options: str, command: list[str] | None = None, **changed: str) -> RawServer:
        servers.append(RawServer({**ros_environment, **changed}, *options, command=command))
        return servers[-1]

    yield begin
    for server in servers:
        server.end()


@pytest.fixture(scope="module")
def small_robot(ros_environment: dict[str, str], agent: Agent) -> Iterator[subprocess.Popen[str]]:
    """A node with services and an action, discovered."""
    script = Path(__file__).parent / "server_robot.py"
    process = subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True, env=ros_environment)
    assert process.stdout
    assert process.stdout.readline() == "ready\n"
    while not all(name in str(agent.call("ros2_service_list")) for name in ("/set_lamp", "/slow_lamp")):
        pass
    while not agent.call("ros2_list_actions")["actions"]:
        pass
    yield process
    process.kill()  # rclpy's threads may sleep in a callback
    process.communicate(timeout=20)
