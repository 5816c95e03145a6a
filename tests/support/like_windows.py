"""Runs `ros2-mcp` where everything is missing that Windows does not have. It is not Windows: the loop and paths stay.

python -m support.like_windows OPTIONS...       as `ros2-mcp OPTIONS...`
python -m support.like_windows --import-all     imports every module of the server, and prints how many there are
"""

from __future__ import annotations

import importlib
import os
import pkgutil
import select
import signal
import socket
import subprocess
import sys
import time
import types

NOT_THERE = ("fcntl", "grp", "pwd", "resource", "syslog", "termios", "tty")
LACKING = {
    os: (
        *("O_CLOEXEC", "O_DIRECTORY", "O_NOFOLLOW", "O_NONBLOCK", "O_PATH", "chown", "fchmod", "fork", "getegid"),
        *("geteuid", "getgid", "getgrouplist", "getpgid", "getuid", "killpg", "memfd_create", "openpty", "pread"),
        *("pwrite", "setsid", "statvfs", "uname"),
    ),
    select: ("PIPE_BUF", "epoll", "poll"),
    signal: ("SIGHUP", "SIGKILL", "SIGALRM", "SIGUSR1", "SIGSTOP", "SIGCONT"),
    socket: ("AF_UNIX", "SO_PEERCRED", "SOCK_NONBLOCK", "SOCK_CLOEXEC"),
    time: ("CLOCK_BOOTTIME", "clock_gettime"),
}
OURS = ("ros2_mcp", "ros2_mcp_bridge", "ros2_mcp_common")


def server_modules() -> list[str]:
    """The names of all modules of the server."""
    import ros2_mcp

    found = pkgutil.walk_packages(ros2_mcp.__path__, "ros2_mcp.")
    return [module.name for module in found if not module.name.endswith("__main__")]


def become_like_windows() -> None:
    """What is not ours is imported before: it would ask Windows itself."""
    for name in server_modules():
        importlib.import_module(name)
    importlib.import_module("anyio._backends._asyncio")
    for name in [name for name in sys.modules if name.partition(".")[0] in OURS]:
        del sys.modules[name]
    for name in NOT_THERE:
        sys.modules[name] = None  # type: ignore[assignment] - an import of it fails from now on
    msvcrt = types.ModuleType("msvcrt")
    vars(msvcrt).update(LK_NBLCK=2, LK_UNLCK=0, locking=lambda *_: None, kbhit=lambda: False)
    sys.modules["msvcrt"] = msvcrt
    unix, pair = socket.AF_UNIX, socket.socketpair
    socket.socketpair = lambda: pair(unix)  # of the event loop, which stays Linux'
    for module, names in LACKING.items():
        for name in names:
            if hasattr(module, name):
                delattr(module, name)
    vars(os).update(O_BINARY=0, O_NOINHERIT=0)
    vars(subprocess).update(CREATE_NEW_PROCESS_GROUP=0, CREATE_NO_WINDOW=0)
    vars(signal).update(SIGBREAK=signal.SIGUSR2)
    sys.platform = "win32"


def main() -> None:
    become_like_windows()
    if sys.argv[1:] == ["--import-all"]:
        print(len([importlib.import_module(name) for name in server_modules()]))
        return
    from ros2_mcp.cli import run

    sys.exit(run(sys.argv[1:]))


if __name__ == "__main__":
    main()
