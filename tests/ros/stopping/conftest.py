"""The real server over real stdio, and the independent observer, which alone judges what reached the robot."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")

from support.driver import MOVING, Driver, write_bag
from support.observer import Observer
from support.velocities import TWIST, cdr

BAG_MESSAGES = 100


def as_users_have_it(environment: dict[str, str]) -> dict[str, str]:
    """Without the profile of the tests: with one, the stopper keeps to its transports."""
    return {name: value for name, value in environment.items() if name != "FASTRTPS_DEFAULT_PROFILES_FILE"}


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where servers find a bag that drives for two seconds."""
    folder = tmp_path_factory.mktemp("bags")
    write_bag(folder, [cdr(TWIST, MOVING)] * BAG_MESSAGES)
    return folder


@pytest.fixture(scope="module")
def server(ros_environment: dict[str, str], observer: Observer, bags: Path) -> Iterator[Driver]:
    """A server that the tests of a file share."""
    driver = Driver(as_users_have_it(ros_environment), "--tools", "all", "--record-dir", str(bags))
    yield driver
    driver.end()


@pytest.fixture
def start_server(ros_environment: dict[str, str], bags: Path) -> Iterator[Callable[..., Driver]]:
    """Start a server of this test's own: `start_server("--tools", "core", VARIABLE="value")`."""
    servers: list[Driver] = []

    def begin(*options: str, **changed: str) -> Driver:
        given = ("--record-dir", str(bags), *(options or ("--tools", "all")))
        servers.append(Driver({**as_users_have_it(ros_environment), **changed}, *given))
        return servers[-1]

    yield begin
    for driver in servers:
        driver.end()
