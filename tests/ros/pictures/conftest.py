"""A real server with all tools, the simulated robot, and a node that publishes a point cloud."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")

from support.agent import Agent, agent_for
from support.processes import peer_command


@pytest.fixture(scope="module")
def agent(ros_environment: dict[str, str], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Agent]:
    """A client of a server with all tools."""
    bags = tmp_path_factory.mktemp("bags")
    with agent_for(ros_environment, "--tools", "all", "--record-dir", str(bags)) as client:
        yield client


@pytest.fixture(scope="module", autouse=True)
def nodes(ros_environment: dict[str, str], agent: Agent) -> Iterator[None]:
    """The simulated robot and the node of `cloud_peer`, both discovered."""
    commands = ([sys.executable, "-m", "ros2_mcp_demo"], peer_command("cloud_peer"))
    pipe = subprocess.PIPE
    processes = [
        subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, env=ros_environment) for command in commands
    ]
    try:
        for process in processes:
            assert process.stdout and process.stdout.readline(), f"{process.args} died"
        agent.knows("/odom", "/scan", "/map", "/cloud", "/cmd_vel")
        yield
    finally:
        for process in processes:
            process.terminate()
        for process in processes:
            try:
                process.communicate(timeout=10)
            except subprocess.TimeoutExpired:
                process.kill()
                process.communicate()
