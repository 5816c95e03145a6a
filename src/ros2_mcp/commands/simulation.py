"""The simulated robot as a process, in a graph of its own."""

# ruff: noqa: T201 - printing is this module's job

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
from collections.abc import Generator, Iterator, Mapping
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


# DDS counts its UDP ports from here, by domain; so the ports that are bound tell which domains are in use.
_FIRST_PORT, _PORTS_OF_A_DOMAIN = 7400, 250
# The last domain all of whose ports Linux leaves to those who ask for them: from 32768 on it gives them to anybody.
_LAST_OWN_DOMAIN = 100
# These know no ROS_AUTOMATIC_DISCOVERY_RANGE.
_BEFORE_DISCOVERY_RANGES = ("foxy", "galactic", "humble")


@dataclass(frozen=True, slots=True)
class Graph:
    """A ROS graph of our own, on this machine only, so that a simulated robot never meets a real one."""

    domain_id: int

    @classmethod
    def private(cls) -> Graph:
        """The highest of the domains 100 to 1 in which nobody on this machine is: mostly the same one each time."""
        used = {(port - _FIRST_PORT) // _PORTS_OF_A_DOMAIN for port in _bound_udp_ports()}
        return cls(next((domain for domain in range(_LAST_OWN_DOMAIN, 0, -1) if domain not in used), _LAST_OWN_DOMAIN))

    def variables(self) -> Mapping[str, str]:
        """What a process needs in its environment to be in this graph."""
        return {"ROS_DOMAIN_ID": str(self.domain_id), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}


def _bound_udp_ports() -> Iterator[int]:
    """The local ports of all UDP sockets of this network namespace."""
    for table in (Path("/proc/net/udp"), Path("/proc/net/udp6")):
        lines = table.read_text("ascii").splitlines()[1:] if table.exists() else []
        # The second column is the local address: "0100007F:1CE8".
        yield from (int(line.split()[1].rpartition(":")[2], 16) for line in lines)


def reach_of_this_machine(distro: str, env: Mapping[str, str]) -> Mapping[str, str]:
    """What keeps a robot of that distribution on this machine; nothing where the environment says how far it goes."""
    if env.get("ROS_AUTOMATIC_DISCOVERY_RANGE") or env.get("ROS_LOCALHOST_ONLY"):
        return {}
    if distro in _BEFORE_DISCOVERY_RANGES:
        return {"ROS_LOCALHOST_ONLY": "1"}
    return {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}


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
