"""A real server, nodes that publish signals of known shape, and the simulated robot; each for one file of tests."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

sys.path.insert(0, str(Path(__file__).parents[1] / "server"))  # the tests import their neighbours

from agent import Agent, agent_for

HERE = Path(__file__).parent


@pytest.fixture(scope="module")
def agent(ros_environment: dict[str, str]) -> Iterator[Agent]:
    """A client of a server with all tools."""
    with agent_for(ros_environment, "--tools", "all") as client:
        yield client


@pytest.fixture(scope="module")
def signals(ros_environment: dict[str, str], agent: Agent) -> Iterator[subprocess.Popen[str]]:
    """The node of `signal_peer.py`, discovered."""
    with peer(ros_environment, str(HERE / "signal_peer.py")) as process:
        agent.knows("/signal", "/signal_late", "/signal_wave", "/signal_copy", "/signal_steady", "/sensor", "/pulse")
        yield process


@pytest.fixture(scope="module")
def robot(ros_environment: dict[str, str], agent: Agent) -> Iterator[subprocess.Popen[str]]:
    """The simulated robot, discovered."""
    with peer(ros_environment, "-m", "ros2_mcp_demo") as process:
        agent.knows("/scan", "/odom", "/map", "/imu", "/diagnostics")
        while not agent.call("ros2_service_list", pattern="/self_test")["services"]:
            pass
        yield process


@pytest.fixture
def stranger(ros_environment: dict[str, str]) -> Iterator[subprocess.Popen[str]]:
    """The node of `stranger_peer.py`."""
    with peer(ros_environment, str(HERE / "stranger_peer.py")) as process:
        yield process


@contextmanager
def peer(environment: dict[str, str], *command: str) -> Iterator[subprocess.Popen[str]]:
    """A Python process that has said something; asked to end, and killed if it does not."""
    pipe = subprocess.PIPE
    process = subprocess.Popen([sys.executable, *command], stdin=pipe, stdout=pipe, text=True, env=environment)
    try:
        assert process.stdout
        assert process.stdout.readline(), f"{command} died"
        yield process
    finally:
        process.terminate()
        try:
            process.communicate(timeout=10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
