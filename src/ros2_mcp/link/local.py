"""The local carrier: the bridge is a child process in the ROS of this machine."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from ros2_mcp.link.carrier import Vitality
from ros2_mcp.link.child import Child, thread_states
from ros2_mcp.link.environment import find_ros, way_out
from ros2_mcp.link.installation import RosInstallation
from ros2_mcp.model.errors import LinkError, RosNotFound
from ros2_mcp.settings import Settings

PACKAGE = "ros2_mcp_bridge"


def start_local(
    settings: Settings, env: Mapping[str, str] = os.environ, *, state: Path | None = None, under_policy: bool = False
) -> LocalBridge:
    """Finds the ROS of this machine and starts a bridge in it; arguments and errors as of `start_carrier`."""
    if sys.platform == "win32":
        raise RosNotFound("The ROS 2 of this machine is not looked for on Windows.", way_out(settings.distro or ""))
    options = [*(("--state", str(state)) if state else ()), *(("--under-policy",) if under_policy else ())]
    return LocalBridge(find_ros(settings, env), options, pass_stderr=settings.debug)


class LocalBridge(Child):
    """A bridge as a child process. It is a `Carrier`."""

    is_remote = False

    # Wheels say hello after about half a second; sourcing setup files from a slow disk takes longer. Chosen, with much
    # room: nothing is lost while a start that will fail is waited for.
    start_s = 20.0

    lease_s = 1.0
    """Four pings, of which a pipe carries each within a millisecond: a process that is late by so much hangs."""

    def __init__(
        self, installation: RosInstallation, options: Sequence[str] = (), *, pass_stderr: bool = False
    ) -> None:
        """Starts the process, with these options, without waiting for anything.

        Raises:
            LinkError: if it cannot be executed.
        """
        self.installation = installation
        try:
            super().__init__(installation.command(PACKAGE, options), pass_stderr=pass_stderr)
        except OSError as error:
            raise LinkError(f"The bridge cannot be started: {error}.", "Run: ros2-mcp doctor") from error

    @property
    def origin(self) -> str:
        """Why this installation was chosen."""
        return self.installation.why

    def describe(self) -> str:
        """Its process, and what it still does before ROS can start: setup files on a slow disk take their time."""
        try:
            is_shell = Path(f"/proc/{self.pid}/comm").read_text().strip() == "bash"  # it becomes Python after them
        except OSError:
            is_shell = False
        scripts = " and ".join(map(str, self.installation.scripts))
        return f"pid {self.pid}, still sourcing {scripts}" if is_shell and scripts else f"pid {self.pid}"

    def alive(self) -> Vitality:
        """What the kernel tells of its threads: one that is stopped or wants to run decides."""
        states = thread_states(self.pid)
        if "T" in states:
            return "stopped"
        if states & {"R", "D"}:
            return "starved"
        return "running" if states else "unknown"

    async def failure(self) -> LinkError | None:
        """None: how it ended says it."""
        return None
