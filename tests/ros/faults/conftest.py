"""A server and peers for each test, ended after it."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path

import pytest
from mcp import Client, StdioServerParameters

sys.path.insert(0, str(Path(__file__).parent))  # the tests import their neighbours

from trouble import Agent, Peer

Scenario = Callable[[Agent], Awaitable[None]]


@pytest.fixture
def play(ros_environment: dict[str, str]) -> Callable[..., None]:
    """Plays a scenario with a server of its own, `play(scenario, limit_s=50)`."""

    def run(scenario: Scenario, limit_s: float = 50) -> None:
        server = StdioServerParameters(command=sys.executable, args=["-m", "ros2_mcp"], env=ros_environment)

        async def talk() -> None:
            async with Client(server) as client:
                await asyncio.wait_for(scenario(Agent(client)), limit_s)

        asyncio.run(talk())

    return run


@pytest.fixture
def peer(ros_environment: dict[str, str]) -> Iterator[Callable[..., Peer]]:
    """Starts nodes, `peer("repeat", "/topic", "std_msgs/msg/String", 100)`; all are ended after the test."""
    peers: list[Peer] = []

    def start(*arguments: object, **variables: str) -> Peer:
        peers.append(Peer({**ros_environment, **variables}, tuple(map(str, arguments))))
        return peers[-1]

    yield start
    for running in peers:
        running.end()
