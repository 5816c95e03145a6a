"""The simulated robot as a process, in a private ROS graph."""

# ruff: noqa: T201 - printing is this module's job

from __future__ import annotations

import asyncio
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Generator, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path

from ros2_mcp.commands.robots import DEFAULT, LATER, ROBOTS
from ros2_mcp.link.environment import find_ros
from ros2_mcp.link.installation import RosInstallation
from ros2_mcp.link.interfaces import SHIPPED, InterfaceCache, build, package_name
from ros2_mcp.model.errors import LinkError, RosNotFound, TimedOut
from ros2_mcp.settings import Settings

# With much reserve: the robot is ready after some seconds, on a loaded machine later.
READY_S = 60.0


# DDS assigns UDP ports from here on, by domain: the bound ports show which domains are in use.
_FIRST_PORT, _PORTS_OF_A_DOMAIN = 7400, 250
# The last domain whose ports Linux never assigns on its own: from port 32768 on it may give them to any socket.
_LAST_OWN_DOMAIN = 100
# A port of a domain, relative to its first: multicast uses 0 and 1, and participants begin at 10.
_CLAIM = 5
_BUILD = ("interfaces", "build")
# The nice value of slow builds: the robot and its observers take precedence.
_GIVES_WAY = 10
# Distributions without ROS_AUTOMATIC_DISCOVERY_RANGE.
_BEFORE_DISCOVERY_RANGES = ("foxy", "galactic", "humble")


@dataclass(frozen=True, slots=True)
class Graph:
    """A private ROS graph on this machine, so that a simulated robot never meets a real robot."""

    domain_id: int

    @classmethod
    def private(cls) -> Graph:
        """Return a graph in the highest unused domain of this machine, from 100 down to 1: usually the same domain each
        time.

        The domain is reserved until this process ends, even if it executes another program.
        """
        used = {(port - _FIRST_PORT) // _PORTS_OF_A_DOMAIN for port in _bound_udp_ports()}
        free = (domain for domain in range(_LAST_OWN_DOMAIN, 0, -1) if domain not in used and _claim(domain))
        return cls(next(free, _LAST_OWN_DOMAIN))

    def variables(self) -> Mapping[str, str]:
        """Return the environment variables of a process in this graph."""
        return {"ROS_DOMAIN_ID": str(self.domain_id), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}


def _claim(domain: int) -> bool:
    """Reserve a domain by a port that participants do not use. Return False if another process has reserved it.

    A port can be bound by one process only, and the system frees it when the process ends.
    """
    claim = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        claim.bind(("127.0.0.1", _FIRST_PORT + _PORTS_OF_A_DOMAIN * domain + _CLAIM))
    except OSError:
        claim.close()
        return False
    claim.set_inheritable(True)  # for `exec` as the robot; child processes do not get it
    claim.detach()
    return True


def _bound_udp_ports() -> Iterator[int]:
    """Yield the local ports of all UDP sockets of this network namespace."""
    for table in (Path("/proc/net/udp"), Path("/proc/net/udp6")):
        lines = table.read_text("ascii").splitlines()[1:] if table.exists() else []
        # The second column is the local address: "0100007F:1CE8".
        yield from (int(line.split()[1].rpartition(":")[2], 16) for line in lines)


def reach_of_this_machine(distro: str, env: Mapping[str, str]) -> Mapping[str, str]:
    """Return variables that keep a robot of that distribution on this machine; none if the environment sets its own
    range.
    """
    if env.get("ROS_AUTOMATIC_DISCOVERY_RANGE") or env.get("ROS_LOCALHOST_ONLY"):
        return {}
    if distro in _BEFORE_DISCOVERY_RANGES:
        return {"ROS_LOCALHOST_ONLY": "1"}
    return {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}


def with_interfaces(settings: Settings, robot: str = DEFAULT) -> Settings:
    """Return the settings with the interface packages of that robot, built if necessary; packages that fail are
    omitted.

    Packages that are built later (`build_later`) are included already: nodes that need one check again until it exists.
    """
    installation = find_ros(settings)
    if installation.kind != "wheels":
        return settings
    try:
        sources = [SHIPPED / package for package in ROBOTS[robot]]
        built = build(installation, sources, InterfaceCache(settings.interface_folder)).packages
    except LinkError as error:
        print(f"note: {error}", file=sys.stderr)
        return settings
    prefixes = (*settings.interface_prefixes, *built, *_later(settings, installation, robot))
    return replace(settings, interface_prefixes=tuple(dict.fromkeys(prefixes)))


def build_later(settings: Settings, robot: str) -> None:
    """Begin to build the packages that the robot can start without, in another process, which ends by itself.

    That process has low priority and prints nothing: if it fails, the robot runs without the packages. It also marks
    the packages as in use, so that servers that start later know them.
    """
    installation = find_ros(settings)
    missing = [package_name(prefix) for prefix in _later(settings, installation, robot) if not prefix.is_dir()]
    if not missing:
        return
    sources = [str(SHIPPED / package) for package in LATER[robot]]  # with those that the missing ones may need
    builder = subprocess.Popen(
        [sys.executable, "-m", "ros2_mcp", "--cache-dir", str(settings.cache_dir), *_BUILD, *sources],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    if sys.platform != "win32":
        os.setpriority(os.PRIO_PROCESS, builder.pid, _GIVES_WAY)


def _later(settings: Settings, installation: RosInstallation, robot: str) -> list[Path]:
    """Return the prefixes of packages that are built later, except packages of which the user has built another
    version.
    """
    if installation.kind != "wheels" or installation.python != sys.executable:
        return []
    cache = InterfaceCache(settings.interface_folder)
    planned = cache.planned(LATER.get(robot, ()))
    others = {package_name(built) for built in cache.in_use(installation.prefix) if built not in planned}
    return [prefix for prefix in planned if package_name(prefix) not in others]


@contextmanager
def simulated_robot(settings: Settings, graph: Graph, robot: str = DEFAULT) -> Generator[str, None, None]:
    """Within this context, a robot runs in the graph; yields the line with which it reports that it is ready.

    Raises:
        TimedOut: if it was not ready within a minute.
        LinkError: if it ended before it was ready.
        RosNotFound: on Windows, where the simulated robot does not run.
    """
    if sys.platform == "win32":
        raise RosNotFound(
            "The simulated robot runs only on Linux.", "In WSL it runs as it is; or name a robot with --robot."
        )
    command = find_ros(with_interfaces(replace(settings, domain_id=graph.domain_id), robot)).command(
        "ros2_mcp_demo", ["--robot", robot, "--until-stdin-closes"]
    )
    process = subprocess.Popen(
        command.argv,
        env={**command.env, **graph.variables()},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        yield asyncio.run(_greeting(process))
    finally:
        _stop(process)


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
    assert sys.platform != "win32"
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
