"""A robot with simulated physics in a process of its own, and a server that drives it."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")

from support.commanded import CommandedProcess


@pytest.fixture(scope="module")
def robot(ros_environment: dict[str, str]) -> Iterator[CommandedProcess]:
    """`driven_robot`; its commands are methods, see there."""
    process = CommandedProcess("driven_robot", ros_environment)
    yield process
    process.kill()
