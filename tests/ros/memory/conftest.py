"""The real server with a folder of its own for recordings, and an independent node that publishes."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")

from support.agent import Agent, agent_for
from support.processes import peer_command, running

StartAgent = Callable[..., Agent]
StartPeer = Callable[..., "subprocess.Popen[str]"]


@pytest.fixture
def start_agent(ros_environment: dict[str, str], tmp_path: Path) -> Iterator[StartAgent]:
    """Start a server of this test's own, which records below `tmp_path`."""
    with ExitStack() as running:

        def begin(*options: str) -> Agent:
            given = ("--tools", "all", "--record-dir", str(tmp_path), *options)
            return running.enter_context(agent_for(ros_environment, *given))

        yield begin


@pytest.fixture
def start_peer(ros_environment: dict[str, str]) -> Iterator[StartPeer]:
    """Start `memory_peer`; it is ready when this returns."""
    with ExitStack() as peers:
        yield lambda *arguments: peers.enter_context(
            running(ros_environment, *peer_command("memory_peer", *arguments), sigterm=False)
        )


@pytest.fixture
def robot(ros_environment: dict[str, str]) -> Iterator[subprocess.Popen[str]]:
    """The simulated robot; it is there when this returns."""
    with running(ros_environment, sys.executable, "-m", "ros2_mcp_demo") as process:
        yield process
