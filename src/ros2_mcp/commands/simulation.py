"""The simulated robot as a process, in a graph of its own."""

# ruff: noqa: T201 - printing is this module's job

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
from collections.abc import Generator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path

from ros2_mcp.link.environment import find_ros
from ros2_mcp.link.interfaces import InterfaceCache, build
from ros2_mcp.model.errors import LinkError, TimedOut
from ros2_mcp.settings import Settings

# Chosen, with much room: the robot says that it is ready after some seconds, on a loaded machine later.
READY_S = 60.0
INTERFACES = Path(__file__).resolve().parents[2] / "ros2_mcp_demo" / "interfaces"


@dataclass(frozen=True, slots=True)
class Graph:
    """A ROS graph of our own, on this machine only, so that a tour never meets a real robot."""

    domain_id: int

    @classmethod
    def private(cls) -> Graph:
        """A domain that is probably free: one of 1 to 99, by this process's number."""
        return cls(os.getpid() % 99 + 1)

    def variables(self) -> Mapping[str, str]:
        """What a process needs in its environment to be in this graph."""
        return {"ROS_DOMAIN_ID": str(self.domain_id), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}


def with_interfaces(settings: Settings) -> Settings:
    """The settings with the robot's own interface packages, built if need be; without what cannot be built."""
    installation = find_ros(settings)
    if installation.kind != "wheels":
        return settings
    try:
        built = build(installation, [INTERFACES], InterfaceCache(settings.interface_folder))
    except LinkError as error:
        print(f"note: {error}", file=sys.stderr)
        return settings
    return replace(settings, interface_prefixes=tuple(dict.fromkeys((*settings.interface_prefixes, *built))))


@contextmanager
def simulated_robot(settings: Settings, graph: Graph) -> Generator[str, None, None]:
    """A running robot in a graph; yields the line with which it says that it is ready.

    Raises:
        TimedOut: if it was not ready within a minute.
        LinkError: if it ended before.
    """
    command = find_ros(with_interfaces(replace(settings, domain_id=graph.domain_id))).command(
        "ros2_mcp_demo", ["--until-stdin-closes"]
    )
    robot = subprocess.Popen(
        command.argv,
        env={**command.env, **graph.variables()},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        yield asyncio.run(_greeting(robot))
    finally:
        _stop(robot)


async def _greeting(robot: subprocess.Popen[str]) -> str:
    assert robot.stdout is not None
    try:
        line = await asyncio.wait_for(asyncio.to_thread(robot.stdout.readline), READY_S)
    except asyncio.TimeoutError as error:
        robot.kill()
        raise TimedOut(f"The simulated robot was not ready within {READY_S:.0f} s.") from error
    if not line:
        raise LinkError(f"The simulated robot ended with code {robot.wait()}.", "Run: ros2-mcp doctor")
    return line.strip()


def _stop(robot: subprocess.Popen[str]) -> None:
    assert robot.stdin is not None
    assert robot.stdout is not None
    with suppress(OSError):
        robot.stdin.close()
    try:
        robot.wait(3.0)
    except subprocess.TimeoutExpired:
        os.killpg(robot.pid, signal.SIGKILL)
        robot.wait()
    robot.stdout.close()
