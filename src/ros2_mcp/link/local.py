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
    """Find the ROS of this machine and start a bridge in it; arguments and errors as in `start_carrier`."""
    if sys.platform == "win32":
        raise RosNotFound("On Windows, this server does not search for a local ROS 2.", way_out(settings.distro or ""))
    options = [*(("--state", str(state)) if state else ()), *(("--under-policy",) if under_policy else ())]
    return LocalBridge(find_ros(settings, env), options, pass_stderr=settings.debug)


class LocalBridge(Child):
    """A bridge as a child process; implements `Carrier`."""

    is_remote = False

    # Wheels send their hello after about half a second; sourcing setup files from a slow disk takes longer. Generous,
    # because a longer wait for a start that will fail costs nothing.
    start_s = 20.0

    lease_s = 1.0
    """The link lease, in s: four pings, each of which takes less than a millisecond over a pipe. A process that is this
    late hangs."""

    def __init__(
        self, installation: RosInstallation, options: Sequence[str] = (), *, pass_stderr: bool = False
    ) -> None:
        """Start the process with these options, without waiting for anything.

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
        """The reason for choosing this installation."""
        return self.installation.why

    def describe(self) -> str:
        """Return the process id, and the setup files while they are still being sourced (slow on a slow disk)."""
        try:
            is_shell = Path(f"/proc/{self.pid}/comm").read_text().strip() == "bash"  # then Python
        except OSError:
            is_shell = False
        scripts = " and ".join(map(str, self.installation.scripts))
        return f"pid {self.pid}, still sourcing {scripts}" if is_shell and scripts else f"pid {self.pid}"

    def alive(self) -> Vitality:
        """Return the state of the process's threads, from the kernel: one suspended or runnable thread decides."""
        states = thread_states(self.pid)
        if "T" in states:
            return "stopped"
        if states & {"R", "D"}:
            return "starved"
        return "running" if states else "unknown"

    async def failure(self) -> LinkError | None:
        """Return None: `ending` has the reason."""
        return None
