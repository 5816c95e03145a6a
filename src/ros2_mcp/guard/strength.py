"""How much a policy holds against an agent that wants around it: said as it is, and never more."""

from __future__ import annotations

import os
import sys
from typing import Literal

from ros2_mcp.settings import Settings

if sys.platform != "win32":
    import pwd

Strength = Literal["enforced", "advisory"]
"""`enforced`: server and policy belong to another Unix user than the agent. `advisory`: they may be the same one, who
could begin another server, or speak to the robot without any."""
_NO_SHELLS = ("nologin", "false", "sync")


def strength_of(settings: Settings) -> Strength:
    """That of a policy in this process.

    Over stdio the agent's client has begun this server, so they are one user. Over HTTP and at a Unix socket they are
    taken for two only where this one is a user whom nobody can be: no root, and without a shell to log into. Windows
    tells nothing of that kind.
    """
    if sys.platform == "win32" or settings.is_stdio or not os.geteuid():
        return "advisory"
    try:
        shell = pwd.getpwuid(os.geteuid()).pw_shell
    except KeyError:  # a container's user without an entry: nobody knows who else is it
        return "advisory"
    return "enforced" if shell.rpartition("/")[2] in _NO_SHELLS else "advisory"
