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
        RosNotFound: if there is no ROS 2 here, or not the one that was asked for.
        LinkError: if the bridge cannot be started.
        BadInput: if the settings name what is not there.
    """
    return start_local(settings, env)
