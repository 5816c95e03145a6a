"""Choose the carrier for the robot in the settings."""

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
    """Start a bridge and its carrier: a child process in the ROS of this machine, or ssh or another program for a
    remote robot.

    Args:
        settings: which robot, and which ROS.
        env: the environment in which to look for ROS.
        state: the robot's state folder, with its latch. Without it, and for a remote robot, the bridge has its own
            latch.
        under_policy: whether the bridge publishes nothing but zeros until it gets the rules.

    Raises:
        RosNotFound: if this machine has no ROS 2, or not the requested distribution.
        LinkError: if the bridge, or the program that reaches it, cannot be started.
        BadInput: if the settings name a workspace or a Python that does not exist.
    """
    if settings.robot.is_remote:
        return start_remote(settings, env, under_policy=under_policy)
    return start_local(settings, env, state=state, under_policy=under_policy)
