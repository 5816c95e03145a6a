"""A real server, nodes that publish signals of known shape, and the simulated robot; each for one file of tests."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")

from support.agent import Agent, until
from support.processes import peer_command, running


@pytest.fixture(scope="module")
def signals(ros_environment: dict[str, str], agent: Agent) -> Iterator[subprocess.Popen[str]]:
    """The node of `signal_peer`, discovered."""
    with running(ros_environment, *peer_command("signal_peer")) as process:
        agent.knows(
            "/signal",
            "/signal_late",
            "/signal_wave",
            "/signal_copy",
            "/signal_steady",
            "/sensor",
            "/pulse",
            "/settings",
        )
        yield process


@pytest.fixture(scope="module")
def robot(ros_environment: dict[str, str], agent: Agent) -> Iterator[subprocess.Popen[str]]:
    """The simulated robot, discovered."""
    with running(ros_environment, sys.executable, "-m", "ros2_mcp_demo") as process:
        agent.knows("/scan", "/odom", "/map", "/imu", "/diagnostics")
        until(lambda: agent.call("ros2_service_list", pattern="/self_test")["services"])
        yield process


@pytest.fixture
def stranger(ros_environment: dict[str, str]) -> Iterator[subprocess.Popen[str]]:
    """The node of `stranger_peer`."""
    with running(ros_environment, *peer_command("stranger_peer")) as process:
        yield process
