"""A server over real stdio that the tests of this folder share, and peers that each test starts and kills."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")

from support.agent import Agent, agent_for
from support.peer_process import Nursery, PeerProcess, reachable
from support.raw_server import RawServer


@pytest.fixture(scope="module")
def agent(nursery: Nursery, ros_environment: dict[str, str]) -> Iterator[Agent]:
    """A client of a server that all tests share."""
    with agent_for(ros_environment, "--tools", "all") as client:
        yield client


@pytest.fixture
def start_agent(ros_environment: dict[str, str]) -> Iterator[Callable[..., Agent]]:
    """Start a server of this test's own."""
    with ExitStack() as running:
        yield lambda *options, **changed: running.enter_context(
            agent_for({**ros_environment, **changed}, "--tools", "all", *options)
        )


@pytest.fixture
def start_raw(nursery: Nursery, ros_environment: dict[str, str]) -> Iterator[Callable[[], RawServer]]:
    """Start a server whose lines the test writes and reads itself."""
    servers: list[RawServer] = []

    def begin() -> RawServer:
        servers.append(RawServer(ros_environment, "--tools", "all"))
        return servers[-1]

    yield begin
    for server in servers:
        server.end()


@pytest.fixture(scope="module")
def nursery(ros_environment: dict[str, str]) -> Iterator[Nursery]:
    """Where all peers come from."""
    nursery = Nursery(ros_environment)
    yield nursery
    nursery.close()


@pytest.fixture
def start_peer(nursery: Nursery, agent: Agent) -> Iterator[Callable[..., PeerProcess]]:
    """Start a peer that the shared server knows: `start_peer("services")`; all are gone after the test."""
    peers: list[PeerProcess] = []

    def begin(*roles: str, **options: Any) -> PeerProcess:
        peers.append(reachable(agent, nursery, *roles, **options))
        return peers[-1]

    yield begin
    for peer in peers:
        peer.leave()


@pytest.fixture(scope="module")
def robot(nursery: Nursery, agent: Agent) -> Iterator[PeerProcess]:
    """The peer that all tests share: everything that does not die."""
    peer = reachable(agent, nursery, "services", "actions", "raw", "nested", "tuned", "valve", "dumb")
    yield peer
    peer.leave()
