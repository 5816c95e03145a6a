"""The real server over real stdio, and a robot to which things happen on command."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")
from support.agent import FULL
from support.commanded import CommandedProcess
from support.listener import HANDSHAKE, MODERN, PATIENCE_S, Listener


@pytest.fixture(scope="module")
def events(ros_environment: dict[str, str]) -> Iterator[CommandedProcess]:
    """A robot to which things happen on command."""
    peer = CommandedProcess("events_peer", ros_environment)
    yield peer
    peer.kill()


@pytest.fixture(scope="module")
def handshake_listener(ros_environment: dict[str, str], events: CommandedProcess) -> Iterator[Listener]:
    """The raw client of the older era that all tests of a file share."""
    with listening(ros_environment, HANDSHAKE) as server:
        yield server


@pytest.fixture(scope="module")
def modern_listener(ros_environment: dict[str, str], events: CommandedProcess) -> Iterator[Listener]:
    """The raw client of the newer era that all tests of a file share."""
    with listening(ros_environment, MODERN) as server:
        yield server


FIXTURES = {HANDSHAKE: "handshake_listener", MODERN: "modern_listener"}


@contextmanager
def listening(environment: dict[str, str], era: str) -> Iterator[Listener]:
    """A raw client of that era; its server knows the robot."""
    server = Listener(environment, "--tools", "all")
    try:
        server.begin(era)
        wait_until_known(server)
        yield server
    finally:
        server.end()


def wait_until_known(server: Listener) -> None:
    """Returns when the server has discovered all of the robot."""
    end = time.monotonic() + PATIENCE_S
    while not all(name in str(server.read("ros2://graph")) for name in ("/events/said", "/events/count")):
        assert time.monotonic() < end, "the robot was not discovered"


@pytest.fixture(params=[HANDSHAKE, MODERN] if FULL else [MODERN])
def listener(request: pytest.FixtureRequest) -> Listener:
    """A raw client of the newer era: what is told and when is the same in both."""
    return request.getfixturevalue(FIXTURES[request.param])


@pytest.fixture(params=[HANDSHAKE, MODERN])
def listener_of_each_era(request: pytest.FixtureRequest) -> Listener:
    """A raw client of each era: the way of asking differs."""
    return request.getfixturevalue(FIXTURES[request.param])
