"""The strength of a policy against an agent that tries to evade it; never overstated."""

from __future__ import annotations

import os
import sys
from typing import Literal

from ros2_mcp.settings import Settings

if sys.platform != "win32":
    import pwd

Strength = Literal["enforced", "advisory"]
"""`enforced`: server and policy belong to another Unix user than the agent. `advisory`: they may belong to the same
user, who could start another server, or command the robot without one."""
_NO_SHELLS = ("nologin", "false", "sync")


def strength_of(settings: Settings) -> Strength:
    """Return the strength of a policy in this process.

    Over stdio the agent's client has started this server, so both are one user. Over HTTP and at a Unix socket the
    policy counts as enforced only if the user of this process is not root and has no login shell, so that the agent
    cannot be this user. Windows provides no such information.
    """
    if sys.platform == "win32" or settings.is_stdio or not os.geteuid():
        return "advisory"
    try:
        shell = pwd.getpwuid(os.geteuid()).pw_shell
    except KeyError:  # a container's user without an entry: other processes may be the same user
        return "advisory"
    return "enforced" if shell.rpartition("/")[2] in _NO_SHELLS else "advisory"
