"""The simulated robot, and servers with prompts over real stdio."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")

from support.prompting import PromptAgent, prompt_agent
from support.raw_server import RawServer


@pytest.fixture(scope="module")
def agent(demo_robot: object, demo_environment: dict[str, str]) -> Iterator[PromptAgent]:
    """A client of a server with the default tools."""
    with prompt_agent(demo_environment) as client:
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
