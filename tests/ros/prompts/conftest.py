"""The simulated robot, and servers with prompts over real stdio."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")

from support.processes import SOURCES, running
from support.prompting import PromptAgent, prompt_agent
from support.raw_server import RawServer

ROBOT_INTERFACES = SOURCES / "ros2_mcp_demo/interfaces"


@pytest.fixture(scope="module")
def demo_environment(ros_environment: dict[str, str]) -> dict[str, str]:
    """The environment of a robot and of servers that know its own interfaces."""
    build = [sys.executable, "-m", "ros2_mcp_interfaces", str(ROBOT_INTERFACES)]
    made = subprocess.run(build, capture_output=True, text=True, timeout=300, env=ros_environment, check=True)
    prefixes = made.stdout.split()
    sites = [f"{prefix}/site-packages" for prefix in prefixes]
    return {
        **ros_environment,
        "PYTHONPATH": os.pathsep.join([*sites, ros_environment["PYTHONPATH"]]),
        "AMENT_PREFIX_PATH": os.pathsep.join([*prefixes, sys.prefix]),
    }


@pytest.fixture(scope="module")
def demo_robot(demo_environment: dict[str, str]) -> Iterator[subprocess.Popen[str]]:
    """The simulated robot of a file of tests."""
    with running(demo_environment, sys.executable, "-m", "ros2_mcp_demo") as robot:
        yield robot


@pytest.fixture(scope="module")
def agent(demo_robot: object, demo_environment: dict[str, str]) -> Iterator[PromptAgent]:
    """A client of a server with every tool."""
    with prompt_agent(demo_environment, "--tools", "all") as client:
        client.agent.knows("/odom", "/scan", "/imu")
        yield client


@pytest.fixture
def start_agent(demo_environment: dict[str, str]) -> Iterator[Callable[..., PromptAgent]]:
    """Start a server of this test's own: `start_agent("--prompts", "folder", mode="legacy")`."""
    with ExitStack() as agents:
        yield lambda *options, mode="auto", **changed: agents.enter_context(
            prompt_agent({**demo_environment, **changed}, *options, mode=mode)
        )


@pytest.fixture
def start_raw(demo_environment: dict[str, str]) -> Iterator[Callable[..., RawServer]]:
    """Start a server whose lines the test writes and reads itself."""
    servers: list[RawServer] = []

    def begin(*options: str) -> RawServer:
        servers.append(RawServer(demo_environment, *options))
        return servers[-1]

    yield begin
    for server in servers:
        server.end()
