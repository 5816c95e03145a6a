"""A server that the tests share, and peers for each test, ended after it."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Awaitable, Callable, Iterator

import pytest
from anyio.from_thread import start_blocking_portal
from mcp import Client, StdioServerParameters

from support.trouble import Agent, Peer

Scenario = Callable[[Agent], Awaitable[None]]
LIMIT_S = 50.0


@pytest.fixture(scope="module")
def play(ros_environment: dict[str, str]) -> Iterator[Callable[..., None]]:
    """Plays a scenario with the server that all tests of the file share, `play(scenario)`."""
    with (
        start_blocking_portal() as portal,
        portal.wrap_async_context_manager(Client(server(ros_environment))) as client,
    ):

        async def bounded(scenario: Scenario) -> None:
            await asyncio.wait_for(scenario(Agent(client)), LIMIT_S)

        yield lambda scenario: portal.call(bounded, scenario)


@pytest.fixture
def play_anew(ros_environment: dict[str, str]) -> Callable[..., None]:
    """Plays a scenario with a server of its own, `play_anew(scenario, limit_s=50)`."""

    def run(scenario: Scenario, limit_s: float = LIMIT_S) -> None:
        async def talk() -> None:
            async with Client(server(ros_environment)) as client:
                await asyncio.wait_for(scenario(Agent(client)), limit_s)

        asyncio.run(talk())

    return run


def server(environment: dict[str, str]) -> StdioServerParameters:
    """How to start one."""
    return StdioServerParameters(command=sys.executable, args=["-m", "ros2_mcp"], env=environment)


@pytest.fixture
def peer(ros_environment: dict[str, str]) -> Iterator[Callable[..., Peer]]:
    """Starts nodes, `peer("repeat", "/topic", "std_msgs/msg/String", 100)`; all are ended after the test.

    It does not wait for them: `agent.knows("/topic")` does.
    """
    peers: list[Peer] = []

    def start(*arguments: object, **variables: str) -> Peer:
        peers.append(Peer({**ros_environment, **variables}, tuple(map(str, arguments))))
        return peers[-1]

    yield start
    for running in peers:
        running.process.terminate()
    for running in peers:
        running.end()
