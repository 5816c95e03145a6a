"""The state of the server and its bridge: versions, health, and what is not possible here."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version

from ros2_mcp.robot import Robot

_LAST_RESTARTS = 5
"""The reasons of the last ones are enough to see a pattern; `bridge_starts` counts all."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Status:
    """The state of the server and its bridge; `limitations` says in words what is not possible here and why."""

    server_version: str
    python: str
    distro: str
    rmw: str
    domain_id: int
    bridge_node: str
    bridge_python: str
    bridge_pid: int
    bridge_starts: int
    bridge_restarts: Sequence[str]
    bridge_uptime_s: float
    bridge_memory_bytes: int
    subscriptions: int
    publishers: int
    service_clients: int
    read_only: bool
    ros_found: str
    limitations: Sequence[str]

    def summary(self) -> str:
        """One line."""
        return f"ROS 2 {self.distro} with {self.rmw}, domain {self.domain_id}; bridge {self.bridge_node} is up."


async def status(robot: Robot, limitations: Sequence[str] = ()) -> Status:
    """The state of the server and its bridge; `limitations` are those of the server that the robot does not know.

    Raises:
        LinkError: saying what is missing, if there is no bridge.
    """
    bridge = await robot.graph.bridge_status()
    found = list(limitations)
    if robot.policy.read_only:
        found.append("Tools that write are absent: the server was started read-only.")
    if bridge.executor == "SingleThreadedExecutor":
        found.append("This rclpy has no EventsExecutor: service calls take a little longer.")
    if lapses := robot.graph.lapses:
        found.append(
            f"The link lease has lapsed {len(lapses)} time(s), the last time after this server had been silent for "
            f"{lapses[-1]:.1f} s: the bridge has stopped what this server moved."
        )
    return Status(
        server_version=version("ros2-mcp"),
        python=platform.python_version(),
        distro=bridge.distro,
        rmw=bridge.rmw,
        domain_id=bridge.domain_id,
        bridge_node=bridge.node,
        bridge_python=bridge.python,
        bridge_pid=bridge.pid,
        bridge_starts=bridge.starts,
        bridge_restarts=bridge.restarts[-_LAST_RESTARTS:],
        bridge_uptime_s=bridge.uptime_s,
        bridge_memory_bytes=bridge.memory_bytes,
        subscriptions=bridge.subscriptions,
        publishers=bridge.publishers,
        service_clients=bridge.clients,
        read_only=robot.policy.read_only,
        ros_found=bridge.found,
        limitations=found,
    )
