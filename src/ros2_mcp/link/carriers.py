"""Which carrier reaches the robot that the settings name."""

from __future__ import annotations

import os
from collections.abc import Mapping

from ros2_mcp.link.carrier import Carrier
from ros2_mcp.link.local import start_local
from ros2_mcp.settings import Settings


def start_carrier(settings: Settings, env: Mapping[str, str] = os.environ) -> Carrier:
    """Starts a bridge and what carries its stream: so far always a child process, in the ROS of this machine.

    Raises:
        RosNotFound: if this machine has no ROS 2, or not the distribution that was asked for.
        LinkError: if the bridge cannot be started.
        BadInput: if the settings name a workspace or a Python that does not exist.
    """
    return start_local(settings, env)
