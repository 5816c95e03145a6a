"""The real server over real stdio, and a robot to which things happen on command."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import cache

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
def listener_of(ros_environment: dict[str, str], events: CommandedProcess) -> Iterator[Callable[[str], Listener]]:
    """A raw client of an era; all tests share the one of each era."""
    with ExitStack() as running:

        @cache
        def begin(era: str) -> Listener:
            server = Listener(ros_environment, "--tools", "all")
            running.callback(server.end)
            server.begin(era)
            wait_until_known(server)
            return server

        yield begin


def wait_until_known(server: Listener) -> None:
    """Returns when the server has discovered all of the robot."""
    end = time.monotonic() + PATIENCE_S
    while not all(name in str(server.read("ros2://graph")) for name in ("/events/said", "/events/count")):
        assert time.monotonic() < end, "the robot was not discovered"


@pytest.fixture(params=[HANDSHAKE, MODERN] if FULL else [MODERN])
def listener(request: pytest.FixtureRequest, listener_of: Callable[[str], Listener]) -> Listener:
    """A raw client of the newer era: what is told and when is the same in both."""
    return listener_of(request.param)


@pytest.fixture(params=[HANDSHAKE, MODERN])
def listener_of_each_era(request: pytest.FixtureRequest, listener_of: Callable[[str], Listener]) -> Listener:
    """A raw client of each era: the way of asking differs."""
    return listener_of(request.param)
