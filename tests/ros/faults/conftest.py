"""A server that the tests share, and peers for each test, ended after it."""

from __future__ import annotations

import sys
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import AbstractAsyncContextManager, asynccontextmanager

import pytest
from mcp import Client, StdioServerParameters

from support.trouble import Agent, Peer


@pytest.fixture(scope="module")
async def agent(anyio_backend: str, ros_environment: dict[str, str]) -> AsyncIterator[Agent]:
    """A client of the server that all tests of the file share."""
    async with Client(server(ros_environment)) as client:
        yield Agent(client)


@pytest.fixture
def start_agent(ros_environment: dict[str, str]) -> Callable[[], AbstractAsyncContextManager[Agent]]:
    """A client of a server of its own for a block: `async with start_agent() as agent`."""

    @asynccontextmanager
    async def begin() -> AsyncIterator[Agent]:
        async with Client(server(ros_environment)) as client:
            yield Agent(client)

    return begin


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
