"""The real server over real stdio, in processes of its own, and an independent ROS node on the other side."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterator

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")

from support.agent import Agent, until
from support.commanded import CommandedProcess
from support.processes import peer_command
from support.raw_server import RawServer


@pytest.fixture(scope="module")
def peer(ros_environment: dict[str, str], agent: Agent) -> Iterator[CommandedProcess]:
    """An independent node that all tests share, discovered."""
    process = CommandedProcess("server_peer", ros_environment)
    process.offer(topic="/peer_is_here", kind="std_msgs/msg/String", seed=1)
    agent.knows("/peer_is_here")
    process.forget(topic="/peer_is_here")
    yield process
    process.end_or_kill()  # Fast DDS keeps one from leaving now and then


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
    process = subprocess.Popen(peer_command("server_robot"), stdout=subprocess.PIPE, text=True, env=ros_environment)
    assert process.stdout
    assert "ready\n" in process.stdout  # reads until there, whatever Fast DDS complains about before
    agent.until_answered("ros2_service_list")  # its bridge may need longer than the 20 s that a call waits for it
    until(lambda: all(name in str(agent.call("ros2_service_list")) for name in ("/set_lamp", "/slow_lamp")))
    until(lambda: agent.call("ros2_list_actions")["actions"])
    # a server throws the answers to a client away that it has not discovered yet
    agent.until_answered("ros2_service_call", service_name="/set_lamp", fields={"data": False}, timeout_sec=1)
    agent.until_answered("ros2_cancel_action_goal", action_name="/fibonacci", cancel_all=True, wait_timeout_sec=1)
    yield process
    process.kill()  # rclpy's threads may sleep in a callback
    process.communicate(timeout=20)
