"""The real server over real stdio, and a robot to which things happen on command."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import cache
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent / "server")]  # the tests import their neighbours

from agent import FULL  # noqa: E402
from commanded import CommandedProcess  # noqa: E402
from listener import HANDSHAKE, MODERN, PATIENCE_S, Listener  # noqa: E402


@pytest.fixture(scope="module")
def events(ros_environment: dict[str, str]) -> Iterator[CommandedProcess]:
    """A robot to which things happen on command."""
    peer = CommandedProcess(HERE / "events_peer.py", ros_environment)
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
