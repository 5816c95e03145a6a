"""What this server runs on, how it is, and what it cannot do."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version

from ros2_mcp.robot import Robot


@dataclass(frozen=True, slots=True)
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


async def status(robot: Robot) -> Status:
    """The state of the server and its bridge.

    Raises:
        LinkError: saying what is missing, if there is no bridge.
    """
    stats = (await robot.graph.ask("stats")).ok
    hello = robot.bridge.hello
    assert hello is not None
    return Status(
        server_version=version("ros2-mcp"),
        python=platform.python_version(),
        distro=hello.distro,
        rmw=hello.rmw,
        domain_id=hello.domain_id,
        bridge_node=hello.node,
        bridge_python=hello.python,
        bridge_pid=hello.pid,
        bridge_starts=robot.bridge.generation,
        bridge_restarts=list(robot.bridge.restarts)[-5:],
        bridge_uptime_s=stats["uptime_s"],
        bridge_memory_bytes=stats["rss_bytes"],
        subscriptions=stats["subscriptions"],
        publishers=stats["publishers"],
        service_clients=stats["clients"],
        read_only=robot.policy.read_only,
        ros_found=robot.bridge.installation.why if robot.bridge.installation else "",
        limitations=_limitations(robot),
    )


def _limitations(robot: Robot) -> list[str]:
    limits = list(robot.limitations)
    if robot.policy.read_only:
        limits.append("Tools that write are absent: the server was started read-only.")
    hello = robot.bridge.hello
    if hello is not None and hello.executor == "SingleThreadedExecutor":
        limits.append("This rclpy has no EventsExecutor: service calls take a little longer.")
    return limits
