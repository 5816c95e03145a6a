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
from support.processes import peer_command

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
    peers: list[subprocess.Popen[str]] = []

    def begin(*arguments: str) -> subprocess.Popen[str]:
        command = peer_command("memory_peer", *arguments)
        pipe = subprocess.PIPE
        peer = subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, env=ros_environment)
        peers.append(peer)
        assert peer.stdout
        assert peer.stdout.readline() == "ready\n"
        return peer

    yield begin
    for peer in peers:
        end(peer)


@pytest.fixture
def robot(ros_environment: dict[str, str]) -> Iterator[subprocess.Popen[str]]:
    """The simulated robot; it is there when this returns."""
    command = [sys.executable, "-m", "ros2_mcp_demo"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=ros_environment)
    assert process.stdout
    assert process.stdout.readline()
    yield process
    process.terminate()
    end(process)


def end(process: subprocess.Popen[str]) -> None:
    """Close its stdin and wait until it has left; a peer that does not is no fault of the server's."""
    try:
        process.communicate(timeout=10)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
