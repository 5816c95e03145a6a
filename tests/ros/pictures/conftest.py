"""A real server with all tools, the simulated robot, and a node that publishes a point cloud."""

from __future__ import annotations

import sys
from collections.abc import Iterator

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")

from support.agent import Agent, agent_for
from support.processes import peer_command, running


@pytest.fixture(scope="module")
def agent(ros_environment: dict[str, str], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Agent]:
    """A client of a server with all tools."""
    bags = tmp_path_factory.mktemp("bags")
    with agent_for(ros_environment, "--tools", "all", "--record-dir", str(bags)) as client:
        yield client


@pytest.fixture(scope="module", autouse=True)
def nodes(ros_environment: dict[str, str], agent: Agent) -> Iterator[None]:
    """The simulated robot and the node of `cloud_peer`, both discovered."""
    robot = running(ros_environment, sys.executable, "-m", "ros2_mcp_demo")
    with robot, running(ros_environment, *peer_command("cloud_peer")):
        agent.knows("/odom", "/scan", "/map", "/cloud", "/cmd_vel")
        yield
