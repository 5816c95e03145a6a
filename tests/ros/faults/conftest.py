"""A server that the tests share, and peers for each test, ended after it."""

from __future__ import annotations

import sys
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import AbstractAsyncContextManager, asynccontextmanager

import pytest
from mcp import Client, StdioServerParameters

from support.agent import CALL_S
from support.async_agent import AsyncAgent
from support.faulty_peer import FaultyPeer


@pytest.fixture(scope="module")
async def agent(anyio_backend: str, ros_environment: dict[str, str]) -> AsyncIterator[AsyncAgent]:
    """A client of the server that all tests of the file share."""
    async with Client(server(ros_environment), read_timeout_seconds=CALL_S) as client:
        yield AsyncAgent(client)


@pytest.fixture
def start_agent(ros_environment: dict[str, str]) -> Callable[[], AbstractAsyncContextManager[AsyncAgent]]:
    """A client of a server of its own for a block: `async with start_agent() as agent`."""

    @asynccontextmanager
    async def begin() -> AsyncIterator[AsyncAgent]:
        async with Client(server(ros_environment), read_timeout_seconds=CALL_S) as client:
            yield AsyncAgent(client)

    return begin


def server(environment: dict[str, str]) -> StdioServerParameters:
    """How to start one."""
    return StdioServerParameters(command=sys.executable, args=["-m", "ros2_mcp"], env=environment)


@pytest.fixture
def peer(ros_environment: dict[str, str]) -> Iterator[Callable[..., FaultyPeer]]:
    """Starts nodes, `peer("repeat", "/topic", "std_msgs/msg/String", 100)`; all are ended after the test.

    It does not wait for them: `agent.knows("/topic")` does.
    """
    peers: list[FaultyPeer] = []

    def start(*arguments: object, **variables: str) -> FaultyPeer:
        peers.append(FaultyPeer({**ros_environment, **variables}, tuple(map(str, arguments))))
        return peers[-1]

    yield start
    for running in peers:
        running.process.terminate()
    for running in peers:
        running.end()
