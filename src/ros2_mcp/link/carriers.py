"""Which carrier reaches the robot that the settings name."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from ros2_mcp.link.carrier import Carrier
from ros2_mcp.link.local import start_local
from ros2_mcp.link.remote import start_remote
from ros2_mcp.settings import Settings


def start_carrier(
    settings: Settings, env: Mapping[str, str] = os.environ, *, state: Path | None = None, under_policy: bool = False
) -> Carrier:
    """Starts a bridge and what carries its stream: a child process in the ROS of this machine, or ssh and its like.

    Args:
        settings: which ROS.
        env: where it is looked for.
        state: the state folder of the robot, with its latch; without it, and where the robot is elsewhere, the bridge
            has a latch of its own.
        under_policy: whether it lets nothing out but zeros until it is told the rules.

    Raises:
        RosNotFound: if this machine has no ROS 2, or not the distribution that was asked for.
        LinkError: if the bridge, or the program that reaches it, cannot be started.
        BadInput: if the settings name a workspace or a Python that does not exist.
    """
    if settings.robot.is_remote:
        return start_remote(settings, env, under_policy=under_policy)
    return start_local(settings, env, state=state, under_policy=under_policy)
