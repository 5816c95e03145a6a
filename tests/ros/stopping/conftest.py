"""The real server over real stdio, and the independent observer, which alone judges what reached the robot."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")

from support.observer import Observer, observing
from support.raw_server import MODERN, RawServer


@pytest.fixture(scope="module")
def observer(ros_environment: dict[str, str]) -> Iterator[Observer]:
    """The observer of a file's tests; each has topics of its own."""
    with observing(ros_environment) as process:
        yield process


@pytest.fixture
def start_raw(ros_environment: dict[str, str]) -> Iterator[Callable[..., RawServer]]:
    """Start a server whose lines the test writes and reads itself: `start_raw("--tools", "core", VARIABLE="value")`."""
    servers: list[RawServer] = []

    def begin(*options: str, **changed: str) -> RawServer:
        server = RawServer({**ros_environment, **changed}, *(options or ("--tools", "all")))
        servers.append(server)
        server.begin(MODERN)
        return server

    yield begin
    for server in servers:
        server.end()
