"""A robot behind a real sshd, with a network between that can be slow, lossy and cut."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")

from ros2_mcp_common.start.finding import rclpy_below, wheel_distro, wheel_environment
from support.driver import Driver
from support.network_link import NetworkLink, network_link
from support.sshd import Sshd, sshd


@pytest.fixture(scope="module")
def login_environment(ros_environment: dict[str, str]) -> dict[str, str]:
    """The environment of the robot's logins, which find the Python that has ROS 2."""
    names = ("ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOG_DIR", "FASTRTPS_DEFAULT_PROFILES_FILE")
    env = {name: ros_environment[name] for name in names if name in ros_environment}
    path = os.pathsep.join([str(Path(sys.executable).parent), "/usr/bin", "/bin"])
    # Of wheels this is sourced: else the simulated robot of another test, in its domain, would be taken for the robot.
    folders = [package.parent for package in rclpy_below(Path(sys.prefix))]
    wheels = wheel_environment({}, Path(sys.prefix), folders[0]) if wheel_distro(folders) else {}
    return {**env, **wheels, "PATH": path}


@pytest.fixture(scope="module")
def laptop_environment(ros_environment: dict[str, str]) -> dict[str, str]:
    """The environment of a server that sees no ROS of its own."""
    own = ("ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE", "FASTRTPS_DEFAULT_PROFILES_FILE")
    return {name: value for name, value in ros_environment.items() if name not in own}


@pytest.fixture(scope="module")
def far(login_environment: dict[str, str], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Sshd]:
    """The robot's sshd."""
    with sshd(tmp_path_factory.mktemp("sshd"), login_environment) as running:
        yield running


@pytest.fixture
def link(far: Sshd) -> Iterator[NetworkLink]:
    """The network between: as fast as this machine, until a test changes it."""
    with network_link(far.port) as between:
        far.knows(between.port)
        yield between


@pytest.fixture
def laptop(
    far: Sshd, link: NetworkLink, laptop_environment: dict[str, str], tmp_path: Path
) -> Iterator[Callable[..., Driver]]:
    """Starts a server whose robot is behind that network; it sees no ROS of its own."""
    servers: list[Driver] = []

    def begin(*options: str) -> Driver:
        ssh = [f"--ssh-option={word}" for word in ("-oConnectTimeout=5", *far.options())]  # outages are short here
        given = ("--robot", far.address(link.port), *ssh, "--record-dir", str(tmp_path), "--tools", "all", *options)
        servers.append(Driver(laptop_environment, *given))
        return servers[-1]

    yield begin
    link.mend()
    for server in servers:
        server.end()
