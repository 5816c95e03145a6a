"""The state of the server and its bridge: versions, health, and limitations."""

from __future__ import annotations

import asyncio
import platform
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib.metadata import version

from ros2_mcp.guard.consent import Auditing
from ros2_mcp.guard.state import RESET_HINT, latched
from ros2_mcp.model.text import counted
from ros2_mcp.ops.results.results import IF_ANY, SAID, microseconds
from ros2_mcp.robot import Robot

NO_POLICY = "none is in force; every valid command is sent"
_OTHER_CLOCK_S = 0.5
"""A smaller offset of the clocks does not matter: tf2 and people wait for tenths of a second. It is far above the
uncertainty of a slow link."""
_LAST_RESTARTS = 5
"""The reasons of the last restarts are enough to see a pattern; `bridge_starts` counts all."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Status:
    """The state of the server and its bridge; `limitations` says what is not possible here, and why.

    `policy` names the policies in force, or says that there are none; `policy_strength` and `policy_digest` are then
    empty. `mode` is the mode in force: the policy's, or a stricter one that the operator has set. `latched`: no command
    is carried out until an operator resets the latch. `audit_head` is the hash at the end of the audit: compare it with
    an earlier copy to detect a rewritten audit. `clock_offset_s` is how far the robot's clock, used for all times, is
    ahead of this machine's clock (0 if the difference is not measurable); `link_rtt_s` is the shortest round-trip time
    to the bridge. Both are null until measured.
    """

    server_version: str
    python: str
    distro: str = field(metadata=SAID)
    rmw: str = field(metadata=SAID)
    domain_id: int = field(metadata=SAID)
    bridge_node: str = field(metadata=SAID)
    bridge_python: str
    bridge_pid: int
    bridge_starts: int
    bridge_restarts: Sequence[str]
    bridge_uptime_s: float
    bridge_memory_bytes: int
    clock_offset_s: float | None
    link_rtt_s: float | None
    subscriptions: int
    publishers: int
    service_clients: int
    read_only: bool
    policy: str = field(metadata=SAID)
    policy_strength: str
    policy_digest: str
    mode: str
    audit_head: str
    latched: bool
    ros_found: str
    robot_seen: bool
    note: str = field(metadata=IF_ANY)
    limitations: Sequence[str]

    def summary(self) -> str:
        """Return the result in one line."""
        ros = f"ROS 2 {self.distro} with {self.rmw}, domain {self.domain_id}; bridge {self.bridge_node} is up."
        strength = f" ({self.policy_strength})" if self.policy_strength else ""
        return f"{ros} Policy: {self.policy}{strength}. {self.note}".rstrip()


async def status(robot: Robot, limitations: Sequence[str] = ()) -> Status:
    """Return the state of the server and its bridge; `limitations` are limits of the server that the robot does not
    know.

    Raises:
        LinkError: if there is no bridge; it says what is missing.
    """
    bridge, absence = await asyncio.gather(robot.graph.bridge_status(), robot.graph.absence())
    found = list(limitations)
    in_force = " and ".join(document.name for document in robot.policy.documents) or NO_POLICY
    if robot.policy.read_only:
        found.append("The server was started read-only: it has no tools that act.")
    if (latch := robot.guard.latch.look()).is_set:
        found.append(f"Commands are rejected: {latched(latch)} {RESET_HINT}")
    auditing = robot.guard.audit
    if isinstance(auditing, Auditing) and auditing.log.failed:
        found.append(f"The audit log cannot be written: {auditing.log.failed}.")
    if other := robot.guard.server_lock.other():
        found.append(other)
    if bridge.executor == "SingleThreadedExecutor":
        found.append("This rclpy has no EventsExecutor, so service calls take a little longer.")
    if other_clock := _other_clock(bridge.clock_offset_s):
        found.append(other_clock)
    if lapses := robot.graph.lapses:
        found.append(
            f"The link lease has expired {counted(len(lapses), 'time')}, last after this server had been silent for "
            f"{lapses[-1]:.1f} s: the bridge stopped what this server moved."
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
        clock_offset_s=microseconds(bridge.clock_offset_s),
        link_rtt_s=microseconds(bridge.link_rtt_s),
        subscriptions=bridge.subscriptions,
        publishers=bridge.publishers,
        service_clients=bridge.clients,
        read_only=robot.policy.read_only,
        policy=in_force,
        policy_strength=robot.guard.strength if robot.policy.in_force else "",
        policy_digest=robot.policy.digest,
        mode=robot.guard.mode if robot.policy.in_force else "",
        audit_head=auditing.log.head.short if isinstance(auditing, Auditing) else "",
        latched=latch.is_set,
        ros_found=bridge.found,
        robot_seen=not absence,
        note=absence,
        limitations=found,
    )


def _other_clock(offset_s: float | None) -> str:
    """Return a sentence if the clocks of robot and server differ; empty if the difference does not matter."""
    if offset_s is None or abs(offset_s) < _OTHER_CLOCK_S:
        return ""
    return (
        f"The robot's clock is {abs(offset_s):.1f} s {'ahead of' if offset_s > 0 else 'behind'} this machine's. All "
        f"times in results and arguments are by the robot's clock."
    )
